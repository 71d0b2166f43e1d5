"""LZF, the compression of binary PCD files (format of liblzf).

A control byte below 32 precedes that many literal bytes plus one. Any other refers back: its upper three bits are the
length minus two (seven: the next byte adds to it), its lower five and the following byte the distance minus one.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

LARGEST_RATIO = 132
"""Maximum compression ratio: three bytes expand to at most 264. Data above it are damaged."""


def unpack(packed: bytes, size: int) -> NDArray[np.uint8]:
    """Decompress LZF data to `size` bytes; `ValueError` if they are damaged or have another size."""
    if size > LARGEST_RATIO * len(packed):
        raise ValueError(f"{len(packed)} bytes cannot decompress to {size}")
    out = np.empty(size, dtype=np.uint8)
    written = _unpack(np.frombuffer(packed, dtype=np.uint8), out)
    if written != size:
        raise ValueError(f"they decompress to {written} bytes instead of {size}")
    return out


@njit(cache=True, nogil=True)
def _unpack(packed: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Fill `out`; return the number of bytes written."""
    at, to = 0, 0
    while at < len(packed):
        control = int(packed[at])
        at += 1
        if control < 32:
            length = control + 1
            if at + length > len(packed) or to + length > len(out):
                return to
            out[to : to + length] = packed[at : at + length]
            at += length
            to += length
            continue
        length = control >> 5
        if length == 7:
            if at >= len(packed):
                return to
            length += int(packed[at])
            at += 1
        length += 2
        if at >= len(packed):
            return to
        source = to - ((control & 31) << 8 | int(packed[at])) - 1
        at += 1
        if source < 0 or to + length > len(out):
            return to
        for i in range(length):  # byte by byte: the two may overlap
            out[to + i] = out[source + i]
        to += length
    return to
