"""Lock of the page of an output folder: a second server on the same folder is refused."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError

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
    path = folder / CACHE / "lock"
    path.parent.mkdir(exist_ok=True)
    with path.open("a+", encoding="utf-8") as stream:
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
