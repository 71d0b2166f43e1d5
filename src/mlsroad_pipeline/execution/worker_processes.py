"""Processes of this machine that are workers of a Dask scheduler: their start, their replacement and their end."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from contextlib import suppress
from multiprocessing.process import BaseProcess
from typing import Any

from distributed import Security

from mlsroad_pipeline.execution import fork_server
from mlsroad_pipeline.execution.dask_worker import serve

logger = logging.getLogger(__name__)

JOIN_SECONDS = 5
"""Longest wait for the end of a killed process."""

_CUT_OFF = 255
"""Exit code that multiprocessing reports for a process whose fork server was killed; the process may still run."""


class WorkerProcesses:
    """Workers of a scheduler; they end with this process."""

    def __init__(
        self, n_workers: int, scheduler: str, security: Security, folder: str, *, host: str | None = None
    ) -> None:
        self._n_workers, self._arguments = n_workers, (scheduler, security, folder, host)
        self._processes: dict[int, BaseProcess] = {}
        self._lock, self._ended = threading.Lock(), False
        for number in range(n_workers):
            self._start(number)

    @property
    def pids(self) -> list[int]:
        """Numbers of the processes."""
        return [process.pid for process in self._processes.values() if process.pid is not None]

    def _start(self, number: int) -> None:
        """Start a worker; the server of the workers forks it, where there is one."""
        context: Any = multiprocessing.get_context("forkserver" if fork_server.is_started() else "spawn")
        process = context.Process(target=serve, args=self._arguments, name=f"dask-worker-{number}", daemon=True)
        # An error: the server was killed, and the next call starts another.
        with fork_server.interrupts_blocked(), suppress(OSError, EOFError):
            process.start()
            self._processes[number] = process

    def all_left(self) -> bool:
        """Return whether all workers have ended by themselves, since their scheduler has."""
        return len(self._processes) == self._n_workers and all(p.exitcode == 0 for p in self._processes.values())

    def replace_ended(self, *, also_left: bool = True) -> None:
        """Start a worker in place of each one that was killed, and of those that have left the scheduler."""
        with self._lock:
            if self._ended:
                return
            for number, process in list(self._processes.items()):
                code = process.exitcode
                if code is not None and (code != 0 or also_left):
                    logger.warning("a worker process was killed or ended (exit code %s): another one is started", code)
                    _kill(self._processes.pop(number))
            for number in range(self._n_workers):
                if number not in self._processes:
                    self._start(number)

    def kill(self) -> None:
        """Kill the workers; they keep nothing that is not stored."""
        with self._lock:
            self._ended = True
            for process in self._processes.values():
                _kill(process)

    def join(self) -> None:
        """Wait until the killed workers have ended."""
        for process in self._processes.values():
            process.join(JOIN_SECONDS)


def _kill(process: BaseProcess) -> None:
    if process.pid is not None and process.exitcode in (None, _CUT_OFF):
        with suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)
