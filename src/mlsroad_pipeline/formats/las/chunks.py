"""Chunks of a LAZ file: chunk table, layers, and ranges of chunks of variable size."""

import io
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.las.counts import table_offset
from mlsroad_pipeline.formats.las.header import RECORD_SIZES, LasHeader

LAYERS = {6: 9, 7: 10, 8: 11, 9: 10, 10: 12}  # layers of a chunk of these point formats; each extra byte has one more


def damaged_rows(path: Path, start: int, stop: int, error: Exception) -> ReadError:
    """Return the error for rows that cannot be decompressed."""
    return ReadError(f"{path} is damaged or truncated within rows {start} to {stop - 1}: {error}")


def check_layers(stream: BinaryIO, header: LasHeader, chunk: tuple[int, int, int], path: Path) -> None:
    """Raise `ReadError` for layers larger than their chunk, before memory is allocated.

    ``chunk`` is its byte offset, size in bytes and number of points. Point formats 0 to 5 have no layers.
    """
    at, n_bytes, n_points = chunk
    if header.point_format not in LAYERS:
        return
    n_layers = LAYERS[header.point_format] + header.record_size - RECORD_SIZES[header.point_format]
    size = header.record_size + 4 + 4 * n_layers
    stream.seek(at)
    head = stream.read(size)
    stated = struct.unpack_from(f"<{n_layers + 1}I", head, header.record_size) if len(head) == size else (0,)
    if stated[0] != n_points or size + sum(stated[1:]) > n_bytes:
        raise ReadError(
            f"{path} is damaged: the chunk at byte {at} states {stated[0]} points in {size + sum(stated[1:])} bytes, "
            f"its table {n_points} in {n_bytes}"
        )


class VariableChunks:
    """Reader of ranges of files with chunks of variable size, such as COPC; lazrs seeks only in chunks of one size.

    ``record`` is the LASzip record, ``chunks`` are points and bytes of each, ``select`` the fields to decompress.
    """

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
        self._size, self._header = header.record_size, header
        self._selection = lazrs.DecompressionSelection(select)
        self._ends = np.cumsum([n_points for n_points, _ in chunks])
        self._begins = header.point_offset + 8 + np.cumsum([0, *(n_bytes for _, n_bytes in chunks)])

    def read(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Return the bytes of the records ``start`` to ``stop``, at least one, chunk by chunk."""
        out = np.empty((stop - start) * self._size, dtype=np.uint8)
        for number in range(int(np.searchsorted(self._ends, start, "right")), len(self._chunks)):
            n_points, n_bytes = self._chunks[number]
            first = int(self._ends[number]) - n_points
            if first >= stop:
                break
            at = int(self._begins[number])
            check_layers(self._stream, self._header, (at, n_bytes, n_points), self._path)
            self._stream.seek(at)
            points = np.empty(n_points * self._size, dtype=np.uint8)
            try:
                lazrs.decompress_points_with_chunk_table(
                    *(self._stream.read(n_bytes), self._record, points, [(n_points, n_bytes)], self._selection)
                )
            except lazrs.LazrsError as error:
                raise damaged_rows(self._path, first, first + n_points, error) from error
            low, high = max(start, first), min(stop, first + n_points)
            part = points[(low - first) * self._size : (high - first) * self._size]
            out[(low - start) * self._size : (high - start) * self._size] = part
        return out


def check_chunk_table(stream: BinaryIO, header: LasHeader, laz: lazrs.LazVlr, path: Path) -> list[tuple[int, int]]:
    """Return points and bytes of each chunk; `ReadError` for an inconsistent table, before decompression."""
    size, begin = stream.seek(0, 2), header.point_offset
    if begin + 8 > size:
        raise ReadError(f"{path} is truncated: it ends at byte {size}, its points begin at {begin}")
    table = table_offset(stream, begin, size)
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


STEP = 100_000  # points that are skipped at a time
CHUNKED = 2  # LASzip compressor of the same streams in chunks, which lazrs decompresses


class _Chunk(io.RawIOBase):
    """The stream as the only chunk of a chunked file: the byte offset of a chunk table precedes it."""

    def __init__(self, stream: BinaryIO, begin: int) -> None:
        self._stream, self._begin, self._at = stream, begin, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + (self._at if whence == io.SEEK_CUR else 0)
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]  # the stub takes any buffer
        if self._at < 8:
            data = struct.pack("<q", 8)[self._at : self._at + len(buffer)]
        else:
            self._stream.seek(self._begin + self._at - 8)
            data = self._stream.read(len(buffer))
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)


class PointwisePoints:
    """Reader of ranges of a file without chunks; a range before the last one is read from the start of the file."""

    def __init__(self, stream: BinaryIO, header: LasHeader, path: Path, record: bytes) -> None:
        self._stream, self._header, self._path = stream, header, path
        own = bytearray(record)
        struct.pack_into("<H", own, 0, CHUNKED)
        struct.pack_into("<I", own, 12, max(min(header.n_points, 2**32 - 2), 1))
        self._record = bytes(own)
        self._restart()

    def _restart(self) -> None:
        source = io.BufferedReader(_Chunk(self._stream, self._header.point_offset), 1 << 20)
        self._decompressor, self._position = lazrs.LasZipDecompressor(source, self._record), 0

    def read(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Return the bytes of the records ``start`` to ``stop``, at least one."""
        size = self._header.record_size
        try:
            if start < self._position:
                self._restart()
            while self._position < start:
                n_points = min(STEP, start - self._position)
                self._decompressor.decompress_many(bytearray(n_points * size))
                self._position += n_points
            out = bytearray((stop - start) * size)
            self._decompressor.decompress_many(out)
        except lazrs.LazrsError as error:
            self._position = stop + 1
            raise damaged_rows(self._path, start, stop, error) from error
        self._position = stop
        return np.frombuffer(out, dtype=np.uint8)
