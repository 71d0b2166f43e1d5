"""Folder of this process for temporary files; the next run removes it if this process was killed."""

import fcntl
import functools
import os
import shutil
import stat
import tempfile
import time
from multiprocessing import util
from pathlib import Path

PREFIX = "mlsroad-"
"""Prefix of the folders, below that of the system for temporary files; short, since paths of sockets have 107 bytes."""

_LOCK = ".scratch-lock"
_SECONDS_TO_LOCK = 60.0
"""Age from which a folder without a lock is that of a killed process."""


def scratch_folder() -> Path:
    """Return the folder of this process, which is removed when the process ends.

    Folders that killed processes of this user left behind are removed first. A lock marks the folder of a running
    process; where the file system has no locks, none is removed.
    """
    if not _folder_of(os.getpid()).is_dir():
        _folder_of.cache_clear()
    return _folder_of(os.getpid())


@functools.lru_cache(maxsize=1)
def _folder_of(process: int) -> Path:
    place = Path(tempfile.gettempdir())
    _remove_stale(place)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
    lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)  # open until the process ends
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # without a lock file none counts as stale
        (folder / _LOCK).unlink()
    # After multiprocessing has removed its own folder below.
    util.Finalize(None, shutil.rmtree, args=(str(folder),), kwargs={"ignore_errors": True}, exitpriority=-200)
    return folder


def _remove_stale(place: Path) -> None:
    """Remove folders of this user that no process has locked; the newest may not be locked yet."""
    for folder in place.glob(f"{PREFIX}*"):
        try:
            status = folder.lstat()
            if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
                continue
            if time.time() - status.st_mtime > _SECONDS_TO_LOCK:
                with (folder / _LOCK).open("r+b") as stream:
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder, ignore_errors=True)
        except OSError:  # in use, or another process removed it
            continue
