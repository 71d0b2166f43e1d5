"""Lock of the page of an output folder: a second server on the same folder is refused."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError

CACHE = ".page"
"""Folder below an output that holds the tiles and the lock; it can be removed at any time."""

_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


class PageInUseError(MlsRoadError):
    """Another process serves the page of the same output folder."""


@contextmanager
def page_lock(folder: Path) -> Iterator[Callable[[str], None]]:
    """Hold the lock of a page; yields a function that enters the address of the page.

    The lock is that of `flock`: it ends with its process, also after a kill.
    """
    with _opened(folder / CACHE) as stream:
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
        raise ReadError(f"{cache} is no folder of its own: remove this link or file and try again")
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
