"""Random access to the bytes of a file, plain or gzip-compressed."""

from __future__ import annotations

import errno
import gzip
import io
import os
import tempfile
import weakref
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import IO, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.formats.files import FileKey, atomic_file, check_expansion, file_key

GZIP, SUFFIX = b"\x1f\x8b", ".gz"
BLOCK = 1 << 24


class Content:
    """Random access to the bytes of a file; a gzip-compressed one is decompressed into an unnamed temporary file."""

    def __init__(self, path: Path) -> None:
        self.path, self.packed = path, is_packed(path)
        self._descriptor = _unpack(path) if self.packed else os.open(path, os.O_RDONLY)
        self.size = os.fstat(self._descriptor).st_size
        weakref.finalize(self, os.close, self._descriptor)

    def read(self, n_bytes: int, at: int = 0) -> bytes:
        """Return up to `n_bytes` from byte offset `at`; fewer at the end."""
        return os.pread(self._descriptor, n_bytes, at)

    def records(self, dtype: np.dtype, at: int, count: int) -> NDArray:
        """Return a memory-mapped, read-only view of `count` records from byte offset `at`; all lie inside the file."""
        if not count * dtype.itemsize:
            return np.empty(count, dtype)
        with os.fdopen(os.dup(self._descriptor), "rb") as stream:
            return np.memmap(cast(IO[bytes], stream), dtype=dtype, mode="r", offset=at, shape=(count,))

    def stream(self) -> io.BufferedReader:
        """Return a new stream over the bytes, to be closed by the caller."""
        path = Path(f"/proc/self/fd/{self._descriptor}") if self.packed else self.path
        return path.open("rb")  # opened anew: each stream has a position of its own


def open_content(path: Path) -> Content:
    """Return a file opened for random access; the last four are cached as long as they do not change."""
    return _content(file_key(path))


@lru_cache(maxsize=4)
def _content(key: FileKey) -> Content:
    return Content(Path(key[0]))


def _unpack(path: Path) -> int:
    with tempfile.TemporaryFile() as unpacked:
        try:
            size = path.stat().st_size
            with gzip.open(path, "rb") as packed:
                while block := packed.read(BLOCK):
                    unpacked.write(block)
                    check_expansion(path, unpacked.tell(), size)
            unpacked.flush()
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise ReadError(f"{path} is damaged or truncated: {error}") from error
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise ReadError(f"{path}: no room to decompress it in {tempfile.gettempdir()}; set TMPDIR") from error
        return os.dup(unpacked.fileno())


def is_packed(path: Path) -> bool:
    """Return whether a file begins with the gzip signature."""
    with path.open("rb") as stream:
        return stream.read(len(GZIP)) == GZIP


def first_bytes(path: Path, n_bytes: int) -> bytes:
    """Return the first bytes of a file, decompressed where it is gzip; `ReadError` where that is damaged."""
    try:
        with gzip.open(path, "rb") if is_packed(path) else path.open("rb") as stream:
            return stream.read(n_bytes)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise ReadError(f"{path} is damaged or truncated: {error}") from error


def with_packed(*extensions: str) -> tuple[str, ...]:
    """Return file name endings and the same with ``.gz`` appended."""
    return (*extensions, *(extension + SUFFIX for extension in extensions))


def unpacked_name(path: Path) -> str:
    """Return a file's name without ``.gz``."""
    return path.name[: -len(SUFFIX)] if path.name.lower().endswith(SUFFIX) else path.name


def refuse_packed(path: Path, form: str) -> None:
    """Raise `DataError` if a file name ends in ``.gz``, for a format that is not written sequentially."""
    if path.name.lower().endswith(SUFFIX):
        raise DataError(f"{path}: {form} is not written as gzip; leave out {SUFFIX}")


@contextmanager
def output_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a stream whose content becomes `path` when the block ends, compressed where the name ends in ``.gz``."""
    with atomic_file(path) as stream:
        if not path.name.lower().endswith(SUFFIX):
            yield stream
            return
        # No name and no time in the gzip header: same points, same bytes.
        with gzip.GzipFile("", "wb", 6, stream, mtime=0) as packed:
            yield cast(BinaryIO, packed)
