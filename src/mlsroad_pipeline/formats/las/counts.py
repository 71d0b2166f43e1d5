"""Number of points and byte offsets of records that a LAS or LAZ file has, against those that its header states."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.formats.content import Content, open_content
from mlsroad_pipeline.formats.files import FileKey

POINTWISE = 1
"""LASzip compressor without chunks (LASzip 1)."""

LAYERED_FROM = 6
"""First point format whose chunks state their number of points."""

SPARE_BYTES = 64
"""Bytes at the end of a chunk without which its points cannot be decompressed; the last 4 are the coder's."""

NOT_COUNTED = (
    "its header states {} points, {} more, whose number is not stated: they are not read; write the file anew from its "
    "source"
)

COMPARED, REACH, NEAR_STEPS = 1000, 100, 1_000_000
"""Number of records that others are compared with, and how far others may be: extents of these, and steps."""

NEAR_EXTENT = 1 << 28
"""Largest extent in steps of points that no header counts: bytes of anything else fill the 32 bits."""

WAVEFORMS = (4, 5, 9, 10)
INTERNAL, EXTERNAL = 0x02, 0x04
"""Bits of the global encoding: waveform packets in the file, or in another one."""


def waveform_start(block: bytes) -> tuple[int, str]:
    """Return the byte offset of the waveform packets of a LAS 1.3 file, 0 if it holds none.

    Parameters
    ----------
    block : bytes
        The public header block.

    Returns
    -------
    start : int
        Byte offset.
    note : str
        Sentence if the offset is not used; else empty.
    """
    start, points = struct.unpack_from("<Q", block, 227)[0], struct.unpack_from("<I", block, 96)[0]
    encoding, point_format = struct.unpack_from("<H", block, 6)[0], block[104] & 0x3F
    if not start:
        return 0, ""
    if point_format not in WAVEFORMS:
        return 0, f"its header states waveform packets at byte {start}, but its points have none: not read"
    if encoding & EXTERNAL and not encoding & INTERNAL:
        return 0, f"its waveform packets are in another file (.wdp), not at byte {start} as its header states: not read"
    if start < points:
        return 0, f"its header states waveform packets at byte {start}, before its points: not read"
    return start, ""


def stored_points(file: Content, block: bytes, stated: int, end: int) -> tuple[int, str]:
    """Return the number of points of an uncompressed file, and a sentence if it is not the stated one.

    Parameters
    ----------
    file : Content
        Bytes of the file.
    block : bytes
        The public header block.
    stated : int
        Number of points that the header states.
    end : int
        Byte offset of what follows the points.

    Returns
    -------
    n_points : int
        The stated number, or a larger one if whole records fill the file; a smaller file is an error of the reader.
    note : str
        Sentence for the user.
    """
    begin, size = struct.unpack_from("<I", block, 96)[0], struct.unpack_from("<H", block, 105)[0]
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
    if not known:
        return _are_records(file.read(min(have, COMPARED) * size, begin), size)
    own, others = (_coordinates(data, size) for data in (known, b"".join(ends)))
    low, high = own.min(axis=0), own.max(axis=0)
    reach = REACH * (high - low).max() + NEAR_STEPS
    return bool(((others >= low - reach) & (others <= high + reach)).all())


def _are_records(data: bytes, size: int) -> bool:
    """Return whether bytes that no header counts are points: near each other, and not all at one place."""
    extent = np.ptp(_coordinates(data[: len(data) // size * size], size), axis=0)
    return bool(0 < extent.max() < NEAR_EXTENT)


def _coordinates(data: bytes, size: int) -> NDArray[np.float64]:
    records = np.frombuffer(data, np.uint8).reshape(-1, size)
    return np.ascontiguousarray(records[:, :12]).view("<i4").astype(np.float64)


@lru_cache(maxsize=64)
def compressed_points(key: FileKey, begin: int, record: bytes, layout: tuple[int, int], stated: int) -> tuple[int, str]:
    """Return the number of points of a LAZ file, as far as its chunks state it, and a sentence if it is another one.

    Parameters
    ----------
    key : tuple
        See `file_key`.
    begin : int
        Byte offset of the points.
    record : bytes
        Data of the LASzip record.
    layout : tuple of int
        Point format and size of a point.
    stated : int
        Number of points that the header states.

    Returns
    -------
    n_points : int
        The stated number, or that of the chunks where it is larger. A damaged table gives the stated number: the
        reader raises the error.
    note : str
        Sentence for the user.
    """
    try:
        laz = lazrs.LazVlr(record)
        with open_content(Path(key[0])).stream() as stream:
            if record[0] == POINTWISE or stream.seek(0, 2) < begin + 8:
                return stated, ""
            stream.seek(begin)
            table = struct.unpack("<q", stream.read(8))[0]
            if table < begin + 8:
                return stated, ""
            stream.seek(table)
            n_chunks = struct.unpack("<II", stream.read(8))[1]
            if n_chunks > (table - begin) // layout[1]:
                return stated, ""
            stream.seek(begin)
            chunks = lazrs.read_chunk_table(stream, laz)
            if chunks and layout[0] < LAYERED_FROM and not laz.uses_variable_size_chunks():
                return stated, _left_over(stream, laz, record, chunks, begin, layout[1], stated)
            n_points = max(stated, _of_chunks(stream, laz, chunks, begin, layout, stated))
            return n_points, f"its header states {stated} points, it holds {n_points}: all are read" * (
                n_points != stated
            )
    except (lazrs.LazrsError, struct.error, OverflowError):
        return stated, ""


def _of_chunks(
    stream: BinaryIO,
    laz: lazrs.LazVlr,
    chunks: Sequence[tuple[int, int]],
    begin: int,
    layout: tuple[int, int],
    stated: int,
) -> int:
    if laz.uses_variable_size_chunks():
        return sum(n_points for n_points, _ in chunks)
    full = (len(chunks) - 1) * laz.chunk_size()
    if not chunks:
        return stated
    stream.seek(begin + 8 + sum(n_bytes for _, n_bytes in chunks[:-1]) + layout[1])
    last = struct.unpack("<I", stream.read(4))[0]
    return full + last if 0 < last <= laz.chunk_size() else stated


def _left_over(
    stream: BinaryIO,
    laz: lazrs.LazVlr,
    record: bytes,
    chunks: Sequence[tuple[int, int]],
    begin: int,
    size: int,
    stated: int,
) -> str:
    """Return a sentence if the last chunk of points of formats 0 to 5 holds more points than the header states.

    Such a chunk does not state its number of points, but the stated ones take all of its bytes.
    """
    n_bytes, n_last = chunks[-1][1], stated - (len(chunks) - 1) * laz.chunk_size()
    if n_bytes < size + SPARE_BYTES or not (n_last < laz.chunk_size() and (n_last > 0 or not stated)):
        return ""
    if not stated:
        return NOT_COUNTED.format(stated, "its chunks hold")
    stream.seek(begin + 8 + sum(number for _, number in chunks[:-1]))
    data = stream.read(n_bytes - SPARE_BYTES)
    try:
        points = np.empty(n_last * size, np.uint8)
        lazrs.decompress_points_with_chunk_table(data, record, points, [(n_last, len(data))])
    except lazrs.LazrsError:
        return ""
    return NOT_COUNTED.format(stated, "its last chunk holds")
