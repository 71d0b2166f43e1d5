"""Number of points in the last chunk of a LAZ file of point formats 0 to 5, which no field of the file states.

The decoder of LASzip reads as many bytes as the encoder writes (M. Isenburg, LASzip, `ArithmeticEncoder::done`): the
last point of a chunk takes its last byte.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from itertools import islice

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.formats.expansion import ALLOWED, LARGEST_RATIO

NOT_COUNTED = (
    "the last chunk of its points is longer than the {} points that its header leaves for it: what follows is not "
    "read; write the file anew from its source"
)
"""Sentence where the chunk is not that of a known compressor."""

EQUAL = "; up to {} more may follow: points equal to the last ones add no byte"
"""Addition to a warning where several numbers of points have the same compressed bytes."""

FIRST_GUESS = 1024
"""Smallest number of points with which the search for the last point begins."""

MOST_TRIES, LARGEST_WORK = 64, 1 << 29
"""Limits of this search: number of compressions of the chunk, and their bytes of points together."""


def stream_points(data: bytes, record: bytes, laz: lazrs.LazVlr, stated: int) -> tuple[int, str]:
    """Return the number of points of a chunk, and a sentence if bytes behind the points are no such points.

    ``stated`` is what the header of the file leaves for the chunk; any number. The result is that number, unless the
    chunk ends before these points, or has bytes behind them and compressing more points gives the same bytes.
    """
    if stated > laz.chunk_size():
        return stated, ""
    if stated > 0 and _unpacked(data[:-1], record, laz, stated) is None:
        enough = _unpacked(data, record, laz, stated) is not None
        return (stated if enough else _most_points(data, record, laz, 0)), ""
    fewest = _most_points(data[:-1], record, laz, stated) + 1
    alone = _unpacked(data, record, laz, fewest + 1) is None
    most = fewest if alone else _most_points(data, record, laz, fewest)
    points = _unpacked(data, record, laz, most)
    if points is None or not points.size:
        return stated, ""
    size = laz.item_size()
    tries = min(MOST_TRIES, LARGEST_WORK // points.size)
    low, high = _same_bytes(fewest, most, tries, lambda n: _packed(points[: n * size], record) == data)
    if not low:
        return stated, NOT_COUNTED.format(max(stated, 0))
    return low, EQUAL.format(high - low) if high > low else ""


def _same_bytes(fewest: int, most: int, tries: int, same: Callable[[int], bool]) -> tuple[int, int]:
    """Return the first and the last of consecutive numbers of points that give the same bytes; zeros if none is found.

    Numbers are tried from the middle of the range on: those that give the same bytes are most of it, or it is short.
    """
    found = next((n for n in islice(_middles(fewest, most), tries) if same(n)), 0)
    if not found:
        return 0, 0
    low, high = fewest - 1, found
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if same(middle) else (middle, high)
    first, low, high = high, found, most + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if same(middle) else (low, middle)
    return first, low


def _middles(low: int, high: int) -> Iterator[int]:
    """Yield the numbers of a range, each time the middle of one of the parts that are left."""
    parts = [(low, high)]
    for first, last in parts:
        if first <= last:
            middle = (first + last) // 2
            yield middle
            parts += [(first, middle - 1), (middle + 1, last)]


def _most_points(data: bytes, record: bytes, laz: lazrs.LazVlr, stated: int) -> int:
    """Return how many points can be decompressed from these bytes, by bisection."""
    size = laz.item_size()
    limit = min(laz.chunk_size(), max(ALLOWED, LARGEST_RATIO * len(data)) // size)
    low, high = max(stated, 0), min(max(2 * stated, FIRST_GUESS), limit + 1)
    while high <= limit and _unpacked(data, record, laz, high) is not None:
        low, high = high, min(2 * high, limit + 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _unpacked(data, record, laz, middle) is None else (middle, high)
    return low


def _unpacked(data: bytes, record: bytes, laz: lazrs.LazVlr, n_points: int) -> NDArray[np.uint8] | None:
    points = np.empty(n_points * laz.item_size(), np.uint8)
    try:
        lazrs.decompress_points_with_chunk_table(data, record, points, [(n_points, len(data))])
    except lazrs.LazrsError:
        return None
    return points


def _packed(points: NDArray[np.uint8], record: bytes) -> bytes:
    """Return points as one chunk."""
    whole = bytes(lazrs.compress_points(lazrs.LazVlr(record), points, False))
    return whole[8 : struct.unpack_from("<q", whole)[0]]
