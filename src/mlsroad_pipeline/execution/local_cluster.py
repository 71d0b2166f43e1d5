"""Dask cluster of this machine, kept for all stages of this process: a scheduler in a thread, workers in processes."""

from __future__ import annotations

import atexit
import logging
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.process import BaseProcess
from typing import Any

import dask
from distributed import Client, LocalCluster, Security

from mlsroad_pipeline.execution import fork_server
from mlsroad_pipeline.execution.dask_worker import SETTINGS, serve
from mlsroad_pipeline.execution.scratch import scratch_folder

logger = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
CLOSE_SECONDS = 5
"""Longest wait for the end of the scheduler."""

_CUT_OFF = 255
"""Exit code that multiprocessing reports for a process whose fork server was killed; the process may still run."""


class KeptCluster:
    """Scheduler, workers and client.

    Scheduler and workers listen on the loopback interface with TLS and a certificate of their own, so that no other
    user of the machine can send them code. A worker that ends is replaced, and all end with this process.

    Parameters
    ----------
    n_workers : int
        The number of worker processes.
    """

    def __init__(self, n_workers: int) -> None:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        self.n_workers, self.n_users, self._driver = n_workers, 0, os.getpid()
        self._lock, self._closed = threading.Lock(), False
        self._folder = tempfile.mkdtemp(dir=scratch_folder())
        self._security = Security.temporary()
        with dask.config.set(SETTINGS), fork_server.temporary_files_in(scratch_folder()):
            self._cluster = LocalCluster(
                n_workers=0,
                host=LOOPBACK,
                protocol="tls://",
                security=self._security,
                dashboard_address=None,
            )
            self.client = Client(self._cluster, set_as_default=False)
        self._workers = [self._start(number) for number in range(n_workers)]

    def _start(self, number: int) -> BaseProcess:
        """Start a worker; the server of the workers forks it, where there is one."""
        context: Any = multiprocessing.get_context("forkserver" if fork_server.is_started() else "spawn")
        process: BaseProcess = context.Process(
            target=serve,
            args=(self._cluster.scheduler_address, self._security, self._folder, number),
            name=f"dask-worker-{number}",
            daemon=True,
        )
        with fork_server.interrupts_blocked():
            process.start()
        return process

    def replace_ended(self) -> None:
        """Start a worker in place of each one that has ended."""
        with self._lock:
            for number, process in enumerate(self._workers):
                if self._closed or process.exitcode is None:
                    continue
                logger.warning("a worker process was killed or ended (%s): another one is started", process.exitcode)
                _kill(process)
                with suppress(OSError, EOFError):  # the fork server was killed: the next call starts another
                    self._workers[number] = self._start(number)

    def is_usable(self) -> bool:
        """Return whether the scheduler runs in this process."""
        return not self._closed and self._driver == os.getpid() and self.client.status == "running"

    def close(self) -> None:
        """End workers and scheduler; a fork of the process that started them does nothing."""
        with self._lock:
            if self._closed or self._driver != os.getpid():
                return
            self._closed = True
            logging.getLogger("distributed").setLevel(logging.CRITICAL)
            for process in self._workers:
                _kill(process)
        with suppress(Exception):
            self.client.close(timeout=CLOSE_SECONDS)
            self._cluster.close(timeout=CLOSE_SECONDS)
        for process in self._workers:
            process.join(CLOSE_SECONDS)
        shutil.rmtree(self._folder, ignore_errors=True)


def _kill(process: BaseProcess) -> None:
    if process.pid is not None and process.exitcode in (None, _CUT_OFF):
        with suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)


_clusters: list[KeptCluster] = []
_clusters_lock = threading.Lock()


@contextmanager
def kept_cluster(n_workers: int) -> Iterator[KeptCluster]:
    """Yield the cluster of this process with that many workers; start it if there is none."""
    with _clusters_lock:
        cluster = _find(n_workers)
        cluster.n_users += 1
    try:
        yield cluster
    finally:
        with _clusters_lock:
            cluster.n_users -= 1


def cluster_of(client: Client) -> KeptCluster | None:
    """Return the kept cluster of a client, if it has one."""
    return next((cluster for cluster in _clusters if cluster.client is client), None)


def _find(n_workers: int) -> KeptCluster:
    """Return the cluster with that many workers; end others that run no stage."""
    for cluster in list(_clusters):
        if not cluster.is_usable() or (cluster.n_users == 0 and cluster.n_workers != n_workers):
            _clusters.remove(cluster)
            cluster.close()
    for cluster in _clusters:
        if cluster.n_workers == n_workers:
            return cluster
    if not _clusters:
        atexit.unregister(close)
        atexit.register(close)
    _clusters.append(KeptCluster(n_workers))
    return _clusters[-1]


def close() -> None:
    """End the clusters of this process."""
    with _clusters_lock:
        while _clusters:
            _clusters.pop().close()
