"""Dask cluster of this machine, kept for all stages of this process: a scheduler in a thread, workers in processes."""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import dask
from distributed import Client, LocalCluster, Security

from mlsroad_pipeline.execution.dask_worker import SETTINGS
from mlsroad_pipeline.execution.fork_server import temporary_files_in
from mlsroad_pipeline.execution.scratch import scratch_folder
from mlsroad_pipeline.execution.worker_processes import WorkerProcesses

LOOPBACK = "127.0.0.1"
CLOSE_SECONDS = 5
"""Longest wait for the end of the scheduler."""

_DISTRIBUTED = logging.getLogger("distributed")


class KeptCluster:
    """Scheduler, workers and client.

    Scheduler and workers listen on the loopback interface with TLS and a certificate of their own, so that no other
    user of the machine can send them code. A worker that ends is replaced, and all end with this process.
    """

    def __init__(self, n_workers: int) -> None:
        self._level = _DISTRIBUTED.level
        _DISTRIBUTED.setLevel(logging.ERROR)
        self.n_workers, self.n_users = n_workers, 0
        self._driver, self._closed = os.getpid(), False
        self._folder = tempfile.mkdtemp(dir=scratch_folder())
        security = Security.temporary()
        with dask.config.set(SETTINGS), temporary_files_in(scratch_folder()):
            self._cluster = LocalCluster(
                n_workers=0,
                host=LOOPBACK,
                protocol="tls://",
                security=security,
                scheduler_kwargs={"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"},
            )
            self.client = Client(self._cluster, set_as_default=False)
        address = self._cluster.scheduler_address
        self.workers = WorkerProcesses(n_workers, address, security, self._folder, host=LOOPBACK)

    def is_usable(self) -> bool:
        """Return whether the scheduler runs in this process."""
        return not self._closed and self._driver == os.getpid() and self.client.status == "running"

    def close(self) -> None:
        """End workers and scheduler; a fork of the process that started them does nothing."""
        if self._closed or self._driver != os.getpid():
            return
        self._closed = True
        _DISTRIBUTED.setLevel(logging.CRITICAL)
        self.workers.kill()
        with suppress(Exception):
            self.client.close(timeout=CLOSE_SECONDS)
            self._cluster.close(timeout=CLOSE_SECONDS)
        self.workers.join()
        _DISTRIBUTED.setLevel(self._level)
        shutil.rmtree(self._folder, ignore_errors=True)


_clusters: list[KeptCluster] = []
_clusters_lock = threading.Lock()


@contextmanager
def kept_cluster(n_workers: int) -> Iterator[KeptCluster]:
    """Yield the cluster of this process with that many workers; start it if there is none.

    After an error or an interrupt it is ended, unless another stage uses it: its workers may be running scenes still.
    """
    with _clusters_lock:
        cluster = _find(n_workers)
        cluster.n_users += 1
    is_complete = False
    try:
        yield cluster
        is_complete = True
    finally:
        with _clusters_lock:
            cluster.n_users -= 1
            if not is_complete and not cluster.n_users and cluster in _clusters:
                _clusters.remove(cluster)
                cluster.close()


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
    _clusters.append(KeptCluster(n_workers))
    return _clusters[-1]


@atexit.register
def close() -> None:
    """End the clusters of this process."""
    with _clusters_lock:
        while _clusters:
            _clusters.pop().close()
