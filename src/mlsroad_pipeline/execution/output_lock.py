"""Lock of an output folder, so that two runs do not write to it at the same time.

The lock is that of `flock`: it ends with its process, also after a kill. It works on local file systems, and between
machines on NFS of Linux and others that pass locks to the server.
"""

import errno
import fcntl
import logging
import os
import socket
from pathlib import Path
from typing import TextIO

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.execution.run_identity import STATE

logger = logging.getLogger(__name__)

LOCK = "lock"
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
_held: dict[str, TextIO] = {}


class OutputInUseError(MlsRoadError):
    """Another run writes to the same output folder."""


def lock_output(output: str | Path) -> None:
    """Lock an output folder for this process; raise OutputInUseError if another run holds it."""
    path = Path(output, STATE, LOCK)
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = path.open("a+", encoding="utf-8")
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        stream.seek(0)
        holder = stream.read().strip() or "another process"
        stream.close()
        raise OutputInUseError(
            f"{output} is in use by {holder}: wait for it, end it, or choose another output"
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            stream.close()
            raise
        logger.warning("%s: this file system has no locks; do not label into it twice at the same time", output)
    stream.truncate(0)
    stream.write(f"process {os.getpid()} on {socket.gethostname()}\n")
    stream.flush()
    _held[str(output)] = stream


def release_output(output: str | Path) -> None:
    """Release the lock of an output folder, if this process holds it."""
    stream = _held.pop(str(output), None)
    if stream is not None:
        stream.truncate(0)
        stream.close()
