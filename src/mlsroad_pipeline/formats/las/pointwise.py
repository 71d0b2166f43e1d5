"""Points of LAZ files without chunks, as LASzip 1 writes them: one stream, read from its start."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.las.header import LasHeader

STEP = 100_000
"""Points that are skipped at a time."""

CHUNKED = 2
"""LASzip compressor of the same streams in chunks, which lazrs decompresses."""


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
            rows = f"rows {start} to {stop - 1}"
            raise ReadError(f"{self._path} is damaged or truncated within {rows}: {error}") from error
        self._position = stop
        return np.frombuffer(out, dtype=np.uint8)
