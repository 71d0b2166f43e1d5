"""The values of an E57 scan's fields, by ranges of records."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.formats.e57.pages import E57Pages
from mlsroad_pipeline.formats.e57.scans import E57Scan


def read_field(pages: E57Pages, scan: E57Scan, name: str, start: int, stop: int) -> NDArray:
    """Return one field of the records ``start`` to ``stop``, scaled."""
    number = next(i for i, f in enumerate(scan.fields) if f.name == name)
    spec, n = scan.fields[number], stop - start
    if n <= 0:
        return np.empty(0, spec.dtype)
    if not spec.bits:
        raw = np.zeros(n, np.int64)
    else:
        first, last = start * spec.bits // 8, -(-stop * spec.bits // 8)
        _hold(pages, scan, number, first, last)
        data = _gather(pages, *scan.streams[number], first, last)
        if spec.kind == "Float":
            return data.view(f"<f{spec.bits // 8}")
        raw = _unpack_bits(data, start * spec.bits - 8 * first, spec.bits, n)
    values = raw + np.int64(spec.minimum)
    return values * spec.scale + spec.offset if spec.kind == "ScaledInteger" else values.astype(spec.dtype)


def _hold(pages: E57Pages, scan: E57Scan, number: int, first: int, last: int) -> None:
    """Read the packets with a part of a field at once: the other fields are in the same packets."""
    before = scan.streams[number][1]
    begin, end = int(np.searchsorted(before, first, "right")) - 1, int(np.searchsorted(before, last))
    pieces = [(starts[begin], starts[end - 1] + sizes[end] - sizes[end - 1]) for starts, sizes in scan.streams]
    pages.hold(int(min(low for low, _ in pieces)), int(max(high for _, high in pieces)))


def _gather(
    pages: E57Pages, starts: NDArray[np.int64], before: NDArray[np.int64], first: int, last: int
) -> NDArray[np.uint8]:
    pieces = []
    begin = int(np.searchsorted(before, first, "right")) - 1
    for i in range(begin, len(starts)):
        low, high = max(first, int(before[i])), min(last, int(before[i + 1]))
        if low >= last:
            break
        pieces.append(pages.read(int(starts[i]) + low - int(before[i]), high - low))
    return np.concatenate(pieces)


@njit(cache=True, nogil=True)
def _unpack_bits(data: NDArray[np.uint8], skip: int, bits: int, n: int) -> NDArray[np.int64]:
    """Return `n` numbers of `bits` bits, least significant bit first, after `skip` bits."""
    out = np.zeros(n, dtype=np.int64)
    for i in range(n):
        at = skip + i * bits
        value = np.uint64(0)
        done = 0
        while done < bits:
            byte, within = (at + done) >> 3, (at + done) & 7
            take = min(8 - within, bits - done)
            part = np.uint64(data[byte] >> within & ((1 << take) - 1))
            value |= part << np.uint64(done)
            done += take
        out[i] = np.int64(value)
    return out
