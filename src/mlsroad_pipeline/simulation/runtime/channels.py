"""Channels between two processes: a pipe for small objects, shared memory for arrays."""

import mmap
import os
import pickle
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError

SLOTS = 2  # Messages that may be in transit in one direction
_SLOT = 24 * 2**20  # bytes; larger messages go over the pipe
_ALIGN = 64  # bytes


class Channel:
    """One end of a two-way channel between processes.

    A pipe passes 64 KiB at a time and needs the interpreter lock for each part, and ray casting holds that lock. Arrays
    therefore go through a file that both ends map. Each message has a slot; the slots are used cyclically.
    """

    def __init__(self, pipe: Connection, path: str, end: int) -> None:
        self._pipe = pipe
        with open(path, "r+b") as file:
            self._memory = memoryview(mmap.mmap(file.fileno(), 2 * SLOTS * _SLOT))
        self._out, self._in = SLOTS * end, SLOTS * (1 - end)
        self._sent = self._received = 0

    def send(self, message: Any) -> None:
        """Send an object; at most `SLOTS` may be in transit."""
        buffers: list[pickle.PickleBuffer] = []
        head = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
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
        """Return the next object; raises EOFError or OSError when the other end is closed."""
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
        """Close the pipe."""
        self._pipe.close()


def create_shared_file() -> str:
    """Create the file of a channel, in memory where there is room; it may be unlinked when both ends have mapped it."""
    size = 2 * SLOTS * _SLOT
    for folder in ("/dev/shm", None):
        if folder and not os.access(folder, os.W_OK):
            continue
        number, path = tempfile.mkstemp(prefix="survey_", dir=folder)
        try:
            # Writing into a mapped file without room for the page would end the process.
            os.posix_fallocate(number, 0, size)
        except OSError as error:
            Path(path).unlink()
            if folder is None:
                raise DataError(f"{path}: no room for {size} bytes of memory shared between processes") from error
            continue
        finally:
            os.close(number)
        return path
    raise AssertionError("the last folder returns or raises")
