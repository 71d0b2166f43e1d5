"""Number of points and byte offsets of records that a LAS or LAZ file has, against those that its header states."""

import struct
from bisect import bisect_left
from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.files import ALLOWED, LARGEST_RATIO, Content, FileKey, open_content

POINTWISE = 1  # LASzip compressor without chunks (LASzip 1)
LAYERED_FROM = 6  # first point format whose chunks state their number of points
# Number of records that others are compared with, and how far others may be: extents of these, and steps.
COMPARED, REACH, NEAR_STEPS = 1000, 100, 1_000_000
# Largest extent in steps of points that no header counts: bytes of anything else fill the 32 bits.
NEAR_EXTENT = 1 << 28
# Sentence where the chunk is not that of a known compressor.
NOT_COUNTED = (
    "the last chunk of its points is longer than the {} points that its header leaves for it: what follows is not "
    "read; write the file anew from its source"
)
# Addition to a warning where several numbers of points have the same compressed bytes.
EQUAL = "; up to {} more may follow: points equal to the last ones add no byte"
FIRST_GUESS = 1024  # smallest number of points with which the search for the last point begins
# Limits of this search: number of compressions of the chunk, and their bytes of points together.
MOST_TRIES, LARGEST_WORK = 64, 1 << 29


def stored_points(file: Content, layout: tuple[int, int], stated: int, end: int) -> tuple[int, str]:
    """Return the number of points of an uncompressed file, and a sentence if it is not the stated one.

    ``layout`` is the byte offset of the points and the size of one. The number is larger than stated if whole records
    fill the file up to ``end``; a smaller file is an error of the reader.
    """
    begin, size = layout
    have, rest = divmod(max(end - begin, 0), size)
    extra = end - begin - stated * size
    if extra <= 0:
        return stated, ""
    if have > stated and (not rest or not stated) and _are_points(file, begin, size, stated, have):
        return have, f"its header states {stated} points, it holds {have}: all are read"
    return stated, f"{extra} bytes after its {stated} points are no points: not read"


def _are_points(file: Content, begin: int, size: int, stated: int, have: int) -> bool:
    """Return whether the first and the last record after the stated ones lie near these."""
    ends = [file.read(size, begin + row * size) for row in (stated, have - 1)]
    if not any(ends[1]):
        return False
    known = file.read(min(stated, COMPARED) * size, begin)
    if not known:  # points that no header counts are near each other, and not all at one place
        data = file.read(min(have, COMPARED) * size, begin)
        extent = np.ptp(_coordinates(data[: len(data) // size * size], size), axis=0)
        return bool(0 < extent.max() < NEAR_EXTENT)
    own, others = (_coordinates(data, size) for data in (known, b"".join(ends)))
    low, high = own.min(axis=0), own.max(axis=0)
    reach = REACH * (high - low).max() + NEAR_STEPS
    return bool(((others >= low - reach) & (others <= high + reach)).all())


def _coordinates(data: bytes, size: int) -> NDArray[np.float64]:
    records = np.frombuffer(data, np.uint8).reshape(-1, size)
    return np.ascontiguousarray(records[:, :12]).view("<i4").astype(np.float64)


@lru_cache(maxsize=64)
def compressed_points(key: FileKey, begin: int, record: bytes, layout: tuple[int, int], stated: int) -> tuple[int, str]:
    """Return the number of points of a LAZ file by its chunks, and a sentence if it is not the stated one.

    ``layout`` is point format and size of a point. A damaged table gives the stated number: the reader raises the
    error. `ReadError` if the last chunk of points of formats 0 to 5 ends before the points that the header states.
    """
    try:
        laz = lazrs.LazVlr(record)
        with open_content(Path(key[0])).stream() as stream:
            if record[0] == POINTWISE or not _has_table(stream, begin, layout[1]):
                return stated, ""
            stream.seek(begin)
            chunks = lazrs.read_chunk_table(stream, laz)
            if not chunks or laz.uses_variable_size_chunks():
                n_points, note = sum(number for number, _ in chunks), ""
            else:
                stream.seek(begin + 8 + sum(n_bytes for _, n_bytes in chunks[:-1]))
                data, full = stream.read(chunks[-1][1]), (len(chunks) - 1) * laz.chunk_size()
                if layout[0] >= LAYERED_FROM:
                    last, note = int(struct.unpack_from("<I", data, layout[1])[0]), ""
                    n_points = full + (last if last <= laz.chunk_size() else 0)
                else:
                    last, note = stream_points(data, record, laz, stated - full)
                    n_points = full + last
                    if full < n_points < stated and last < laz.chunk_size():
                        raise ReadError(
                            f"{key[0]} is truncated or damaged: its header states {stated} points, it holds {n_points}"
                        )
    except (lazrs.LazrsError, struct.error, OverflowError):
        return stated, ""
    if n_points > stated:
        return n_points, f"its header states {stated} points, it holds {n_points}: all are read{note}"
    return stated, note


def table_offset(stream: BinaryIO, begin: int, end: int) -> int:
    """Return the byte offset of the chunk table that a file from its points to its end states."""
    stream.seek(begin)
    table = int(struct.unpack("<q", stream.read(8))[0])
    if table == -1:  # a writer that cannot seek back puts it at the end
        stream.seek(end - 8)
        table = int(struct.unpack("<q", stream.read(8))[0])
    return table


def _has_table(stream: BinaryIO, begin: int, size: int) -> bool:
    """Return whether the chunk table lies behind the points and has no more chunks than fit before it."""
    end = stream.seek(0, 2)
    if end < begin + 8:
        return False
    table = table_offset(stream, begin, end)
    if not begin + 8 <= table <= end - 8:
        return False
    stream.seek(table)
    return bool(struct.unpack("<II", stream.read(8))[1] <= (table - begin) // size)


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
    first = fewest + bisect_left(range(fewest, found), True, key=same)
    return first, found + bisect_left(range(found + 1, most + 1), True, key=lambda n: not same(n))


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
    return low + bisect_left(range(low + 1, high), True, key=lambda n: _unpacked(data, record, laz, n) is None)


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
