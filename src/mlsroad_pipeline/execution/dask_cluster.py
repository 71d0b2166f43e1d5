"""Scenes on a Dask cluster that is given by the address of its scheduler, and errors for what is missing."""

import functools
import itertools
import logging
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from queue import Empty, Queue
from typing import NamedTuple
from urllib.parse import urlsplit

from distributed import Client, Future
from distributed.comm.core import CommClosedError

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.execution.settings import Execution
from mlsroad_pipeline.execution.worker import Outcome, SceneJob, run_scene

logger = logging.getLogger(__name__)

CONNECT_SECONDS = 30
"""Longest wait for a scheduler."""

WORKER_SECONDS = 60
"""Longest wait for a worker, at the start and whenever all have left."""

POLL_SECONDS = 1
"""Seconds between two checks of the workers while no scene ends."""

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_LOST = (CancelledError, CommClosedError, OSError, RuntimeError)
"""Errors of a client whose scheduler is gone; distributed raises all of these."""


class ClusterError(MlsRoadError):
    """A Dask cluster without scheduler, workers or a common folder."""


class Ended(NamedTuple):
    """Scene that has ended: its outcome, or the error for which it has none."""

    key: str
    outcome: Outcome | None
    error: BaseException | None


def run_on_cluster(jobs: Sequence[SceneJob], execution: Execution) -> Iterator[Ended]:
    """Run scenes and yield them as they end.

    Futures of the client are used in place of joblib's Dask backend, which waits forever for a task whose worker was
    killed, and does not cancel running tasks when the caller stops.
    """
    address = str(execution.scheduler)
    _warn_of_open_ports(address)
    with _connected(address) as client:
        try:
            client.wait_for_workers(1, timeout=WORKER_SECONDS)
        except TimeoutError:
            raise ClusterError(_no_worker(address)) from None
        yield from _run(client, jobs, execution)


def _run(client: Client, jobs: Sequence[SceneJob], execution: Execution) -> Iterator[Ended]:
    address, seen = str(execution.scheduler), time.monotonic()
    waiting, open_jobs, ended = iter(jobs), dict[Future, SceneJob](), Queue[Future]()

    def submit(number: int | None) -> None:
        for job in itertools.islice(waiting, number):
            future = client.submit(run_scene, job, key=f"{job.store.name}-{job.key}-{job.token}", pure=False)
            open_jobs[future] = job
            future.add_done_callback(ended.put)

    try:
        submit(execution.n_workers)
        while open_jobs:
            try:
                future = ended.get(timeout=POLL_SECONDS)
            except Empty:
                seen = time.monotonic() if client.scheduler_info(n_workers=-1)["workers"] else seen
                if time.monotonic() - seen > WORKER_SECONDS:
                    raise ClusterError(_no_worker(address)) from None
                continue
            job, seen = open_jobs.pop(future), time.monotonic()
            submit(1)  # first, so that the worker does not wait for the caller
            error = future.exception()
            yield Ended(job.key, None if error else future.result(), error)
    except ClusterError:
        raise
    except _LOST as error:
        raise ClusterError(
            f"the Dask scheduler {address} was stopped or restarted, or the network is cut: start it and its workers, "
            "then the same command continues"
        ) from error
    finally:
        if client.status == "running":
            client.cancel(list(open_jobs))


def _no_worker(address: str) -> str:
    return (
        f"the Dask scheduler {address} has had no worker for {WORKER_SECONDS} s: start some with "
        f"`dask worker {address} --nthreads 1`, then the same command continues"
    )


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        client = Client(address, set_as_default=False, timeout=CONNECT_SECONDS)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(
            f"no Dask scheduler answers at {address} within {CONNECT_SECONDS} s: start one with `dask scheduler`, or "
            "correct execution.scheduler"
        ) from error
    with client:
        yield client


@functools.lru_cache(maxsize=8)
def _warn_of_open_ports(address: str) -> None:
    if not address.startswith("tls://") and urlsplit(address).hostname not in LOOPBACK:
        logger.warning("%s has no TLS: whoever reaches its ports runs code as you; see docs/execution.md", address)
