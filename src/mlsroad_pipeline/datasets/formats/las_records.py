"""Point records of LAS and LAZ files, by ranges, as they are stored."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import lazrs
import numpy as np
from laspy.point.dims import ALL_POINT_FORMATS_DTYPE
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import ReadError
from mlsroad_pipeline.datasets.formats.files import clip_range
from mlsroad_pipeline.datasets.formats.las_header import (
    LASZIP,
    RECORD_SIZES,
    LasHeader,
)

SELECT_ALL = int(lazrs.SELECTIVE_DECOMPRESS_ALL)


def record_dtype(header: LasHeader) -> np.dtype:
    """Return the structured type of a file's records, bit fields packed.

    Parameters
    ----------
    header : LasHeader
        The file's header.

    Returns
    -------
    dtype
        Fields named as laspy names them, then the extra dimensions; one whose name is taken gets ``_extra`` appended.
    """
    fields = list(ALL_POINT_FORMATS_DTYPE[header.point_format].descr)
    taken = {name for name, _ in fields}
    for dimension in header.extra_dimensions:
        name = dimension.name or "unnamed"
        while name in taken:
            name += "_extra"
        taken.add(name)
        fields.append((name, *dimension.field_type[1:]))
    return np.dtype(fields)


class RecordReader:
    """Reads ranges of records of one file; use it as a context manager.

    Parameters
    ----------
    path : Path
        A LAS or LAZ file.
    header : LasHeader
        Its header.
    n_threads : int, default 1
        Above one, LAZ chunks are decompressed in parallel.
    select : int, default all
        For point formats 6 to 10 in LAZ: which fields are decompressed (lazrs flags); others are zero.

    Raises
    ------
    ReadError
        If the file holds fewer points than its header says, or its chunk table is damaged.
    """

    def __init__(self, path: Path, header: LasHeader, *, n_threads: int = 1, select: int = SELECT_ALL) -> None:
        self.path, self.header, self.dtype = path, header, record_dtype(header)
        self._stream = path.open("rb")
        self._position = 0
        self._decompressor = None
        self._octree: _VariableChunks | None = None
        try:
            if header.compressed and header.n_points:
                self._decompressor = self._open_laz(n_threads, select)
            else:
                self._check_size()
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> Self:
        """Return the reader."""
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, start: int, stop: int | None = None) -> NDArray:
        """Read records.

        Parameters
        ----------
        start, stop : int
            First row and the row after the last; None is the end. Beyond the end is clipped.

        Returns
        -------
        structured ndarray
            The records.

        Raises
        ------
        ReadError
            If the file ends early or its compressed data are damaged.
        """
        start, stop = clip_range(start, stop, self.header.n_points)
        buffer = bytearray((stop - start) * self.header.record_size)
        if not buffer:
            return np.empty(0, dtype=self.dtype)
        if self._octree is not None:
            return self._octree.read(start, stop).view(self.dtype)
        if self._decompressor is None:
            self._stream.seek(self.header.point_offset + start * self.header.record_size)
            if self._stream.readinto(buffer) != len(buffer):
                raise ReadError(f"{self.path} is truncated within rows {start} to {stop - 1}")
        else:
            self._decompress(buffer, start, stop)
        return np.frombuffer(buffer, dtype=self.dtype)

    def _decompress(self, buffer: bytearray, start: int, stop: int) -> None:
        assert self._decompressor is not None
        try:
            if start != self._position:
                self._decompressor.seek(start)
            self._decompressor.decompress_many(buffer)
        except lazrs.LazrsError as error:
            self._position = -1
            rows = f"rows {start} to {stop - 1}"
            raise ReadError(f"{self.path} is damaged or truncated within {rows}: {error}") from error
        self._position = stop

    def _check_size(self) -> None:
        header, size = self.header, self.path.stat().st_size
        needed = header.point_offset + header.n_points * header.record_size
        if needed > size:
            have = (size - header.point_offset) // header.record_size
            raise ReadError(f"{self.path} is truncated: its header says {header.n_points} points, it holds {have}")

    def _open_laz(self, n_threads: int, select: int) -> lazrs.LasZipDecompressor | lazrs.ParLasZipDecompressor:
        vlr = self.header.find(LASZIP)
        assert vlr is not None
        try:
            laz = lazrs.LazVlr(vlr.data)
            if laz.item_size() != self.header.record_size:
                expected = self.header.record_size
                raise ReadError(
                    f"{self.path} is damaged: its LASzip record describes points of {laz.item_size()} bytes, "
                    f"its header of {expected}"
                )
            chunks = check_chunk_table(self._stream, self.header, laz, self.path)
            if laz.uses_variable_size_chunks():
                self._octree = _VariableChunks(self._stream, self.header, self.path, vlr.data, chunks, select)
            self._stream.seek(self.header.point_offset)
            kind = lazrs.ParLasZipDecompressor if n_threads > 1 else lazrs.LasZipDecompressor
            return kind(self._stream, vlr.data, lazrs.DecompressionSelection(select))
        except lazrs.LazrsError as error:
            raise ReadError(f"{self.path} is damaged: {error}") from error


class _VariableChunks:
    """Ranges of files whose chunks differ in size, such as COPC: lazrs finds places in chunks of one size only."""

    def __init__(
        self,
        stream: BinaryIO,
        header: LasHeader,
        path: Path,
        record: bytes,
        chunks: Sequence[tuple[int, int]],
        select: int,
    ) -> None:
        self._stream, self._path, self._record, self._chunks = stream, path, record, chunks
        self._size = header.record_size
        self._selection = lazrs.DecompressionSelection(select)
        self._ends = np.cumsum([n_points for n_points, _ in chunks])
        self._begins = header.point_offset + 8 + np.cumsum([0, *(n_bytes for _, n_bytes in chunks)])

    def read(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Return the bytes of the records of a range that is not empty, chunk by chunk."""
        out = np.empty((stop - start) * self._size, dtype=np.uint8)
        for number in range(int(np.searchsorted(self._ends, start, "right")), len(self._chunks)):
            n_points, n_bytes = self._chunks[number]
            first = int(self._ends[number]) - n_points
            if first >= stop:
                break
            self._stream.seek(int(self._begins[number]))
            points = np.empty(n_points * self._size, dtype=np.uint8)
            try:
                lazrs.decompress_points_with_chunk_table(
                    *(self._stream.read(n_bytes), self._record, points, [(n_points, n_bytes)], self._selection)
                )
            except lazrs.LazrsError as error:
                rows = f"rows {first} to {first + n_points - 1}"
                raise ReadError(f"{self._path} is damaged or truncated within {rows}: {error}") from error
            low, high = max(start, first), min(stop, first + n_points)
            part = points[(low - first) * self._size : (high - first) * self._size]
            out[(low - start) * self._size : (high - start) * self._size] = part
        return out


def check_chunk_table(stream: BinaryIO, header: LasHeader, laz: lazrs.LazVlr, path: Path) -> list[tuple[int, int]]:
    """Refuse a chunk table that cannot be true, before the decompressor believes it.

    Parameters
    ----------
    stream : binary stream
        The file.
    header : LasHeader
        Its header.
    laz : lazrs.LazVlr
        Its LASzip record.
    path : Path
        What messages call it.

    Returns
    -------
    list of tuple of int
        Points and bytes of each chunk.

    Raises
    ------
    ReadError
        If the table lies outside the file or disagrees with the number of points or the size of the file.
    """
    size = stream.seek(0, 2)
    begin = header.point_offset
    if begin + 8 > size:
        raise ReadError(f"{path} is truncated: it ends at byte {size}, its points begin at {begin}")
    stream.seek(begin)
    table = struct.unpack("<q", stream.read(8))[0]
    if table == -1:  # a writer that could not seek back states it at the end
        stream.seek(size - 8)
        table = struct.unpack("<q", stream.read(8))[0]
    if not begin + 8 <= table <= size - 8:
        raise ReadError(f"{path} is truncated: its chunk table would be at byte {table}, and it has {size} bytes")
    stream.seek(table)
    n_chunks = struct.unpack("<II", stream.read(8))[1]
    smallest = RECORD_SIZES[header.point_format]  # a chunk begins with one uncompressed point
    if n_chunks > (table - begin) // smallest:
        raise ReadError(f"{path} is damaged: {n_chunks} chunks in {table - begin} bytes of points")
    stream.seek(begin)
    chunks = lazrs.read_chunk_table(stream, laz)
    n_bytes = sum(b for _, b in chunks)
    if laz.uses_variable_size_chunks():
        fits = sum(n for n, _ in chunks) == header.n_points
    else:
        fits = len(chunks) == -(-header.n_points // laz.chunk_size())
    if not fits or begin + 8 + n_bytes > table:
        raise ReadError(
            f"{path} is damaged: {len(chunks)} chunks of {n_bytes} bytes for {header.n_points} points "
            f"in {table - begin - 8} bytes"
        )
    return list(chunks)
