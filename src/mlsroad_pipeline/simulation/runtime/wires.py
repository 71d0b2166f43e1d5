"""How two processes of a survey talk: small things over a pipe, arrays through memory that both of them see."""

from __future__ import annotations

import mmap
import os
import pickle
import tempfile
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError

SLOTS = 2
"""Messages that may be on their way in one direction before the first of them must have been received."""

_SLOT = 24 * 2**20  # bytes; a message that is larger goes over the pipe
_ALIGN = 64  # bytes


class Wire:
    """One end of a line between two processes.

    A pipe of 64 KiB at a time would need the interpreter for every piece of a message, and who casts rays does not let
    go of it. So arrays lie in a file that both ends map, in a slot of their message's own; slots are used in turn.

    Parameters
    ----------
    pipe : Connection
        This end of the pipe.
    path : str
        The file.
    end : int
        0 for who made the file, 1 for the other.
    """

    def __init__(self, pipe: Connection, path: str, end: int) -> None:
        self._pipe = pipe
        with open(path, "r+b") as file:
            self._memory = memoryview(mmap.mmap(file.fileno(), 2 * SLOTS * _SLOT))
        self._out, self._in = SLOTS * end, SLOTS * (1 - end)
        self._sent = self._received = 0

    def send(self, thing: Any) -> None:
        """Send an object; no more than `SLOTS` may be on their way."""
        buffers: list[pickle.PickleBuffer] = []
        head = pickle.dumps(thing, protocol=5, buffer_callback=buffers.append)
        raw = [buffer.raw() for buffer in buffers]
        starts = np.cumsum([0, *(-(-part.nbytes // _ALIGN) * _ALIGN for part in raw)])
        fits = int(starts[-1]) <= _SLOT
        if fits:
            slot = (self._out + self._sent % SLOTS) * _SLOT
            for part, start in zip(raw, starts[:-1].tolist(), strict=True):
                np.frombuffer(self._memory, np.uint8, part.nbytes, slot + start)[:] = np.frombuffer(part, np.uint8)
        self._sent += 1
        self._pipe.send((head, [part.nbytes for part in raw], starts.tolist() if fits else None))
        for part in () if fits else raw:
            if part.nbytes:
                self._pipe.send_bytes(part)

    def receive(self) -> Any:
        """Return the next object; EOFError or OSError says that the other end is gone."""
        head, sizes, starts = self._pipe.recv()
        buffers = [np.empty(size, np.uint8) for size in sizes]
        slot = (self._in + self._received % SLOTS) * _SLOT
        self._received += 1
        for k, buffer in enumerate(buffers):
            if starts is not None:
                buffer[:] = np.frombuffer(self._memory, np.uint8, len(buffer), slot + starts[k])
            elif len(buffer):
                self._pipe.recv_bytes_into(buffer)
        return pickle.loads(head, buffers=buffers)

    def close(self) -> None:
        """Hang up."""
        self._pipe.close()


def shared_file() -> str:
    """Make the file of a line, in memory where the system has such a place and room in it.

    Returns
    -------
    str
        Its path; `forget` it when both ends have it.

    Raises
    ------
    DataError
        If there is no room for it on the disk either.
    """
    size = 2 * SLOTS * _SLOT
    for folder in ("/dev/shm", None):
        if folder and not os.access(folder, os.W_OK):
            continue
        number, path = tempfile.mkstemp(prefix="survey_", dir=folder)
        try:
            # Reserved, as writing into a file that cannot grow ends the process.
            os.posix_fallocate(number, 0, size)
        except OSError as error:
            forget(path)
            if folder is None:
                raise DataError(f"{path}: no room for {size} bytes to share between processes") from error
            continue
        finally:
            os.close(number)
        return path
    raise AssertionError("the last folder returns or raises")


def forget(path: str) -> None:
    """Remove the name of a shared file; who has mapped it keeps it."""
    with suppress(OSError):
        Path(path).unlink()
