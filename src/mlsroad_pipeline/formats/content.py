"""The bytes of a file, plain or gzip, at any position."""

from __future__ import annotations

import errno
import gzip
import io
import os
import shutil
import tempfile
import weakref
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.formats.files import FileKey, atomic_file, file_key

GZIP, SUFFIX = b"\x1f\x8b", ".gz"
BLOCK = 1 << 24


class Content:
    """The bytes of a file at any position; a packed one is unpacked into a temporary file that has no name.

    Parameters
    ----------
    path : Path
        The file; packed if it begins as gzip does.

    Raises
    ------
    ReadError
        If the packed data are damaged or truncated, or the disk has no room for what they hold.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.packed = path, is_packed(path)
        self._descriptor = _unpack(path) if self.packed else os.open(path, os.O_RDONLY)
        self.size = os.fstat(self._descriptor).st_size
        weakref.finalize(self, os.close, self._descriptor)

    def read(self, n_bytes: int, at: int = 0) -> bytes:
        """Return up to `n_bytes` from position `at`.

        Parameters
        ----------
        n_bytes : int
            How many bytes.
        at : int, default 0
            Position of the first.

        Returns
        -------
        bytes
            The bytes; fewer at the end.
        """
        return os.pread(self._descriptor, n_bytes, at)

    def records(self, dtype: np.dtype, at: int, count: int) -> NDArray:
        """Return a view of records; what is not looked at is not read.

        Parameters
        ----------
        dtype : dtype
            Type of a record.
        at : int
            Position of the first.
        count : int
            How many; they lie inside the file.

        Returns
        -------
        ndarray of shape (count,)
            The records, read only.
        """
        if not count * dtype.itemsize:
            return np.empty(count, dtype)
        with os.fdopen(os.dup(self._descriptor), "rb") as stream:
            return np.memmap(cast(IO[bytes], stream), dtype=dtype, mode="r", offset=at, shape=(count,))

    def stream(self) -> io.BufferedReader:
        """Return a new stream over the bytes, to be closed by the caller.

        Returns
        -------
        binary stream
            At the first byte.
        """
        return io.BufferedReader(_Unpacked(self)) if self.packed else self.path.open("rb")


class _Unpacked(io.RawIOBase):
    """A stream with a position of its own, however many read the same content."""

    def __init__(self, content: Content) -> None:
        self._content, self._at = content, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._content.size}[whence]
        return self._at

    def readinto(self, buffer: Any) -> int:
        data = self._content.read(len(buffer), self._at)
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)


def open_content(path: Path) -> Content:
    """Open a file, or take it from those opened last.

    Parameters
    ----------
    path : Path
        An existing file.

    Returns
    -------
    Content
        Its bytes, unpacked once as long as the file does not change.

    Raises
    ------
    ReadError
        If it is packed and damaged.
    """
    return _content(file_key(path))


@lru_cache(maxsize=4)
def _content(key: FileKey) -> Content:
    return Content(Path(key[0]))


def _unpack(path: Path) -> int:
    with tempfile.TemporaryFile() as unpacked:
        try:
            with gzip.open(path, "rb") as packed:
                shutil.copyfileobj(packed, unpacked, BLOCK)
            unpacked.flush()
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise ReadError(f"{path} is damaged or truncated: {error}") from error
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise ReadError(f"{path}: no room to unpack it in {tempfile.gettempdir()}; set TMPDIR") from error
        return os.dup(unpacked.fileno())


def is_packed(path: Path) -> bool:
    """Return whether a file is gzip, by its first bytes.

    Parameters
    ----------
    path : Path
        An existing file.

    Returns
    -------
    bool
        Whether it is.
    """
    with path.open("rb") as stream:
        return stream.read(len(GZIP)) == GZIP


def first_bytes(path: Path, n_bytes: int) -> bytes:
    """Return the first bytes of a file, unpacked where it is gzip; the rest is not read.

    Parameters
    ----------
    path : Path
        An existing file.
    n_bytes : int
        Their number.

    Returns
    -------
    bytes
        The bytes; fewer where there are no more.

    Raises
    ------
    ReadError
        If it is packed and damaged.
    """
    try:
        with gzip.open(path, "rb") if is_packed(path) else path.open("rb") as stream:
            return stream.read(n_bytes)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise ReadError(f"{path} is damaged or truncated: {error}") from error


def with_packed(*extensions: str) -> tuple[str, ...]:
    """Return extensions and those of the same files as gzip.

    Parameters
    ----------
    *extensions : str
        File name endings, with the dot.

    Returns
    -------
    tuple of str
        Both.
    """
    return (*extensions, *(extension + SUFFIX for extension in extensions))


def unpacked_name(path: Path) -> str:
    """Return a file's name without the ending of gzip.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    str
        ``street.xyz`` of ``street.xyz.gz``.
    """
    return path.name[: -len(SUFFIX)] if path.name.lower().endswith(SUFFIX) else path.name


def refuse_packed(path: Path, form: str) -> None:
    """Refuse gzip for a format that is not written sequentially.

    Parameters
    ----------
    path : Path
        The file to write.
    form : str
        Name of its format.

    Raises
    ------
    DataError
        If the file's name ends in ``.gz``.
    """
    if path.name.lower().endswith(SUFFIX):
        raise DataError(f"{path}: {form} is not written as gzip; leave out {SUFFIX}")


@contextmanager
def output_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a stream whose content becomes `path` when the block ends, packed where the name ends in ``.gz``.

    Parameters
    ----------
    path : Path
        The file to write; see `atomic_file`.

    Yields
    ------
    binary stream
        Open for writing.
    """
    with atomic_file(path) as stream:
        if not path.name.lower().endswith(SUFFIX):
            yield stream
            return
        # No name and no time in the gzip head: same points, same bytes.
        with gzip.GzipFile("", "wb", 6, stream, mtime=0) as packed:
            yield cast(BinaryIO, packed)
