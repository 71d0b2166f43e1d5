"""Number of points and byte offsets of records that a LAS or LAZ file has, against those that its header states."""

from __future__ import annotations

import struct
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.content import Content, open_content
from mlsroad_pipeline.formats.files import FileKey
from mlsroad_pipeline.formats.las.last_chunk import stream_points

POINTWISE = 1
"""LASzip compressor without chunks (LASzip 1)."""

LAYERED_FROM = 6
"""First point format whose chunks state their number of points."""

COMPARED, REACH, NEAR_STEPS = 1000, 100, 1_000_000
"""Number of records that others are compared with, and how far others may be: extents of these, and steps."""

NEAR_EXTENT = 1 << 28
"""Largest extent in steps of points that no header counts: bytes of anything else fill the 32 bits."""

WAVEFORMS = (4, 5, 9, 10)
INTERNAL, EXTERNAL = 0x02, 0x04
"""Bits of the global encoding: waveform packets in the file, or in another one."""


def waveform_start(block: bytes) -> tuple[int, str]:
    """Return the byte offset of the waveform packets of a LAS 1.3 file, 0 without, and a sentence if it is not used."""
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

    It is larger than stated if whole records fill the file up to ``end``; a smaller file is an error of the reader.
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
                    n_points, note = full + _of_layers(data, layout[1], laz.chunk_size()), ""
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


def _has_table(stream: BinaryIO, begin: int, size: int) -> bool:
    """Return whether the chunk table lies behind the points and has no more chunks than fit before it."""
    end = stream.seek(0, 2)
    if end < begin + 8:
        return False
    stream.seek(begin)
    table = struct.unpack("<q", stream.read(8))[0]
    if table == -1:  # a writer that cannot seek back puts it at the end
        stream.seek(end - 8)
        table = struct.unpack("<q", stream.read(8))[0]
    if not begin + 8 <= table <= end - 8:
        return False
    stream.seek(table)
    return bool(struct.unpack("<II", stream.read(8))[1] <= (table - begin) // size)


def _of_layers(data: bytes, size: int, largest: int) -> int:
    last = int(struct.unpack_from("<I", data, size)[0])
    return last if last <= largest else 0
