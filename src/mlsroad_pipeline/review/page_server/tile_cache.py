"""Cache of the page of an output folder: tiles, found or built in a process of their own, and the lock."""

import atexit
import errno
import fcntl
import hashlib
import json
import multiprocessing
import multiprocessing.process
import os
import shutil
import signal
import socket
import stat
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TextIO

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError
from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles
from mlsroad_pipeline.review.page_server.tile_building import build_tiles, unfinished
from mlsroad_pipeline.review.page_server.tile_format import FORMAT, FirstPicture, TileIndex, point_bytes

CACHE = ".page"
"""Folder below an output that holds the tiles and the lock; it can be removed at any time."""

_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


class PageInUseError(MlsRoadError):
    """Another process serves the page of the same output folder."""


@lru_cache
def cache_of(folder: Path) -> Path:
    """Return the folder of the cache: below the output, or a temporary one where nothing can be written there."""
    cache = folder / CACHE
    if os.access(cache if os.path.lexists(cache) else folder, os.W_OK):
        return cache
    temporary = tempfile.mkdtemp(prefix="mlsroad-page-")
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return Path(temporary)


@contextmanager
def page_lock(folder: Path) -> Iterator[Callable[[str], None]]:
    """Hold the lock of a page; yields a function that enters the address of the page.

    The lock is that of `flock`: it ends with its process, also after a kill.
    """
    with _opened(cache_of(folder)) as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            holder = " ".join(stream.read().split()) or "another process"
            raise PageInUseError(
                f"{folder} is open in the browser already: {holder}. Use that page, or end it (Ctrl-C) and try again"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise

        def enter(address: str) -> None:
            stream.truncate(0)
            stream.write(f"{address} of process {os.getpid()} on {socket.gethostname()}\n")
            stream.flush()

        try:
            yield enter
        finally:
            stream.truncate(0)


def _opened(cache: Path) -> TextIO:
    """Open the lock file; raise ReadError where it or its folder is a link, since the file is emptied."""
    if cache.is_symlink() or (cache.exists() and not cache.is_dir()):
        raise ReadError(f"{cache} is a link or a file, not a folder: remove it and try again")
    cache.mkdir(exist_ok=True)
    path = cache / "lock"
    foreign = ReadError(f"{path} is a link, or no file: remove it and try again")
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR):
            raise foreign from None
        raise
    found = os.fstat(number)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
        os.close(number)
        raise foreign
    return os.fdopen(number, "a+", encoding="utf-8")


TILES, PICTURE = "tiles-", "first-"
_START = multiprocessing.get_context("spawn")


def mark_of(folder: Path, names: list[str]) -> str:
    """Return what changes with the labelled files: a digest of their names, sizes and times."""
    states = [(name, (folder / name).stat().st_size, (folder / name).stat().st_mtime_ns) for name in names]
    return hashlib.blake2b(json.dumps([FORMAT, states]).encode(), digest_size=8).hexdigest()


class TileCache:
    """Tiles of an output folder."""

    def __init__(self, folder: Path, names: list[str]) -> None:
        self._output, self._names = folder, names
        self._mark = mark_of(folder, names)
        self.folder = cache_of(folder) / f"{TILES}{self._mark}"
        self._process: multiprocessing.process.BaseProcess | None = None
        self._channel: Connection | None = None
        self._share, self._error = 0.0, ""
        self._guard, self._stopped = threading.Lock(), False
        self._index: TileIndex | None = None

    @property
    def _picture(self) -> Path:
        return self.folder.with_name(f"{PICTURE}{self._mark}")

    def kept_picture(self) -> FirstPicture | None:
        """Return the first picture of an earlier opening, None if there is none of these files or it is damaged."""
        try:
            text, _, chunk = self._picture.read_bytes().partition(b"\n")
            facts = json.loads(text)
            whole = len(chunk) == facts["n_points"] * point_bytes(facts["coloured"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return FirstPicture(chunk, facts) if whole else None

    def keep_picture(self, picture: FirstPicture) -> None:
        """Keep the first picture for the next opening."""
        if self.folder.parent.is_dir() and self.kept_picture() is None:
            with atomic_file(self._picture) as stream:
                stream.write(json.dumps(picture.facts).encode() + b"\n" + picture.chunk)

    def start(self) -> None:
        """Start to build the tiles if there are none; those of other versions of the files are removed."""
        for other in self.folder.parent.glob(f"{TILES}*"):
            if other != self.folder:
                shutil.rmtree(other, ignore_errors=True)
        for picture in self.folder.parent.glob(f"{PICTURE}*"):
            if picture != self._picture:
                picture.unlink()
        with self._guard:
            if self.index() is None and not self._stopped:
                self._start()

    def _start(self) -> None:
        """Start the process; Ctrl-C does not reach it, it is ended by `stop`."""
        self._channel, other_end = _START.Pipe(duplex=False)
        arguments = (str(self._output), self._names, str(self.folder), other_end)
        self._process = _START.Process(target=_build, args=arguments, daemon=True)
        resource_tracker.ensure_running()  # it would unblock the signal
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))  # inherited by the process
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            other_end.close()

    def index(self) -> TileIndex | None:
        """Return the index, None while the tiles are not finished."""
        if self._index is None:
            self._index = TileIndex.read(self.folder)
        return self._index

    def status(self) -> dict[str, Any]:
        """Return the state: `ready`, `building` with the share that is done, `failed` with the reason, or `stale`."""
        try:
            changed = mark_of(self._output, self._names) != self._mark
        except OSError:
            changed = True
        if changed:
            return {"state": "stale", "share": 1.0}
        if self.index() is not None:
            return {"state": "ready", "share": 1.0}
        with self._guard:  # two tabs may request it at the same time
            self._receive()
        alive = not self._error if self._process is None else self._process.is_alive()
        if not alive and self.index() is None:
            return {"state": "failed", "share": self._share, "error": self._error or "the process ended early"}
        return {"state": "building", "share": self._share}

    def _receive(self) -> None:
        while self._channel is not None and self._channel.poll():
            try:
                kind, value = self._channel.recv()
            except EOFError:
                self._channel = None
                break
            if kind == "share":
                self._share = value
            else:
                self._error = value

    def fail(self, reason: str) -> None:
        """State why the tiles cannot be built."""
        self._error = reason

    def stop(self) -> None:
        """End the process that builds."""
        with self._guard:
            self._stopped = True
            if self._process is not None and self._process.is_alive():
                self._process.terminate()
                self._process.join()
                shutil.rmtree(unfinished(self.folder), ignore_errors=True)


def _build(output: str, names: list[str], folder: str, channel: Connection) -> None:
    """Build tiles and send the share that is done; the process ends with the one that started it."""
    parent = multiprocessing.parent_process()

    def progress(share: float) -> None:
        if parent is not None and not parent.is_alive():
            raise SystemExit
        channel.send(("share", share))

    try:
        build_tiles(CloudFiles.at(Path(output), names), Path(folder), progress=progress)
    except (KeyboardInterrupt, BrokenPipeError):
        pass
    except Exception as error:  # shown in the page
        channel.send(("error", " ".join(str(error).split()) or type(error).__name__))
