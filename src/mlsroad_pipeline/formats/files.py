"""Files: opening with clear errors, random access to their bytes, plain or gzip-compressed, and atomic writing."""

import errno
import fcntl
import glob
import gzip
import io
import logging
import os
import tempfile
import uuid
import weakref
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import IO, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened

logger = logging.getLogger(__name__)

LAZ_CHUNK = 50_000  # points of a chunk in LAZ files that LASzip, lazrs and PDAL write
FileKey = tuple[str, int, int]  # path, size and modification time: the key of cached properties of a file


def check_file(path: str | Path) -> Path:
    """Return the path of a file that exists, is readable and not empty; raise `ReadError` otherwise."""
    path = Path(path)
    if path.is_dir():
        raise ReadError(f"{path} is a folder, not a file")
    try:
        with path.open("rb") as stream:
            if not stream.read(1):
                raise ReadError(f"{path} is empty (0 bytes)")
    except FileNotFoundError:
        raise ReadError(f"{path} does not exist") from None
    except OSError as error:
        raise ReadError(f"{path} cannot be read: {error.strerror}") from error
    return path


def spread_starts(n_points: int, runs: int, size: int) -> list[int]:
    """Return the first rows of ``runs`` runs of ``size`` points that are spread evenly over a file, ascending.

    In large files they are first points of LAZ chunks, which can be decompressed from there only.
    """
    starts = np.linspace(0, max(n_points - size, 0), runs).astype(np.int64)
    if n_points >= runs * LAZ_CHUNK:
        starts -= starts % LAZ_CHUNK
    return [int(start) for start in np.unique(starts)]


def file_key(path: Path) -> FileKey:
    """Return the cache key of a file's present content: path, bytes and modification time in nanoseconds."""
    status = path.stat()
    return str(path), status.st_size, status.st_mtime_ns


@lru_cache(maxsize=4096)
def log_once(source: str, text: str) -> None:
    """Log a note about a file, once per note."""
    logger.info("%s: %s", source, text)


# Errors that content raises whose types, keys or sizes are others than its reader takes for granted.
WRONG = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RuntimeError)


@contextmanager
def named_errors(path: str | Path, what: str) -> Iterator[None]:
    """Turn the errors that damaged content raises inside the block into a one-line `ReadError` that names the file.

    ``what`` is what the file, or its folder, should be, such as "a table of poses".
    """
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            yield
    except MlsRoadError as error:
        text = printable(error)
        if str(path) in text and text == str(error):
            raise
        raise ReadError(text if str(path) in text else f"{path}: {text}") from error
    except WRONG as error:
        raise ReadError(f"{path}: is not {what}: {type(error).__name__}: {shortened(printable(error), 200)}") from error


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a stream whose content becomes `path` when the block ends and is discarded when it raises.

    The temporary file is in the same folder, which is made if it is missing. Unfinished files of killed processes for
    the same path are removed.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_parts_of_killed_runs(path)
    temporary, opened = _open_part(path)
    try:
        with opened as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file; it appears whole or not at all."""
    with atomic_file(path) as stream:
        stream.write(content)


def _open_part(path: Path) -> tuple[Path, BinaryIO]:
    """Create and lock an unfinished file of `path`; another process may remove one before it is locked."""
    while True:
        part = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
        stream = part.open("w+b")
        try:
            if _lock(stream) and part.exists():
                return part, stream
        except OSError:  # a network file system without locks: nobody removes the part there
            return part, stream
        stream.close()


def _lock(stream: BinaryIO) -> bool:
    """Lock a file until it is closed; return whether no other process has locked it."""
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _remove_parts_of_killed_runs(path: Path) -> None:
    """Remove unfinished files of `path` that no process has locked."""
    for part in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        try:
            with part.open("r+b") as stream:
                if _lock(stream):
                    part.unlink()
        except OSError:  # another process removed it, or the file system has no locks
            continue


def clip_range(start: int, stop: int | None, n_points: int) -> tuple[int, int]:
    """Return ``start`` and ``stop`` (None: the end) clipped to ``n_points`` rows."""
    end = max(start, n_points) if stop is None else stop
    if start < 0 or end < start:
        raise ValueError(f"row range must satisfy 0 <= start <= stop, got {start}..{stop}")
    return min(start, n_points), min(end, n_points)


LARGEST_RATIO = 200  # largest ratio of unpacked to packed bytes; recordings reach about 30
ALLOWED = 1 << 28  # unpacked bytes that any file may have


def check_expansion(path: Path, unpacked: int, packed: int) -> None:
    """Raise `ReadError` for a file that unpacks to far more than a recording does.

    That is more than `ALLOWED` bytes and more than `LARGEST_RATIO` times its packed size.
    """
    if unpacked > max(ALLOWED, LARGEST_RATIO * packed):
        raise ReadError(
            f"{path} is damaged or made to fill the memory: its {packed} bytes would become {unpacked} or more"
        )


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
