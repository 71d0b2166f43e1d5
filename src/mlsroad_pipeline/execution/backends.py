"""Where scenes are run: in this process, in processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import itertools
import tempfile
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.execution.settings import Execution
from mlsroad_pipeline.execution.task import SceneFailure
from mlsroad_pipeline.execution.worker import Outcome, SceneJob, SharedLimit, describe_error, run_scene, warm_up

if TYPE_CHECKING:
    from distributed import Client, Future

MAX_BROKEN_POOLS = 3
"""How often the workers are started again after one was killed, before the rest of the stage is given up."""

KILLED = (
    "its worker process was killed, also when it ran alone; the usual reason is memory: make the scenes shorter, or "
    "give the process more"
)

# One pool of processes serves all stages of this process, and a stage that fails ends the pool.
_pool_lock = threading.Lock()
_shared_limit = SharedLimit()


def run_jobs(jobs: Sequence[SceneJob], execution: Execution) -> Generator[Outcome, None, None]:
    """Run scenes and yield what became of each, in the order in which they end.

    Every job yields exactly one outcome, also if its worker dies. If the caller stops early, or is interrupted, the
    scenes in work are abandoned.

    Raises
    ------
    ParameterError
        If the store lies in this process's memory and the backend uses other processes.
    """
    if execution.backend in ("loky", "dask") and any(job.storage.is_private for job in jobs):
        raise ParameterError(f"{jobs[0].storage.url}: only the backends sequential and threading reach this memory")
    runners: dict[str, Callable[[Sequence[SceneJob], Execution], Generator[Outcome, None, None]]] = {
        "sequential": _run_here,
        "threading": _run_here,
        "loky": _run_processes,
        "dask": _run_dask,
    }
    yield from runners[execution.backend](jobs, execution)


def _run_here(jobs: Sequence[SceneJob], execution: Execution) -> Generator[Outcome, None, None]:
    with _shared_limit.hold():
        if execution.backend == "sequential":
            yield from map(run_scene, jobs)
        else:
            yield from _parallel(jobs, execution.n_local_workers, backend="threading")


def _parallel(
    jobs: Iterable[Any], n_workers: int, function: Callable[[Any], Any] = run_scene, **config: Any
) -> Generator[Any, None, None]:
    # No memory mapping of large arguments: they would reach the function read-only, and with this backend alone.
    with joblib.parallel_config(n_jobs=n_workers, max_nbytes=None, **config):
        parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch=n_workers)
        yield from parallel(joblib.delayed(function)(job) for job in jobs)


def _run_processes(jobs: Sequence[SceneJob], execution: Execution) -> Generator[Outcome, None, None]:
    """Run scenes in processes; those in work when a process is killed get a second chance, one by one."""
    with _pool_lock:
        waiting = list(jobs)
        suspects: list[SceneJob] = []
        for _ in range(MAX_BROKEN_POOLS):
            started, ended = _Counted(waiting), set()
            try:
                for outcome in _processes(started, execution.n_local_workers):
                    ended.add(outcome.key)
                    yield outcome
                waiting = []
                break
            except TerminatedWorkerError:
                suspects += [job for job in started.taken if job.key not in ended]
                waiting = waiting[len(started.taken) :]
        for job in suspects:
            try:
                yield from _processes([job], 1)
            except TerminatedWorkerError:
                yield _failed(job, KILLED)
        for job in waiting:
            yield _failed(job, f"was not run: workers of this stage were killed {MAX_BROKEN_POOLS} times")


def _processes(
    jobs: Iterable[Any], n_workers: int, function: Callable[[Any], Any] = run_scene
) -> Generator[Any, None, None]:
    # With one job joblib would run it in this process, which is not to die of a scene.
    yield from _parallel(jobs, max(n_workers, 2), function, backend="loky", inner_max_num_threads=1)


class _Counted:
    """Iterates once and remembers what was taken."""

    def __init__(self, jobs: Sequence[SceneJob]) -> None:
        self._jobs = jobs
        self.taken: list[SceneJob] = []

    def __iter__(self) -> Iterator[SceneJob]:
        for job in self._jobs:
            self.taken.append(job)
            yield job


def warm_workers(execution: Execution) -> None:
    """Start the processes that stages run in, and let each load what `label` needs."""
    n_workers = max(execution.n_local_workers, 2)
    at_once = max(int(joblib.cpu_count()) - 1, 1)  # a core is left to this process, which has its own start to make
    with _pool_lock, tempfile.TemporaryDirectory(prefix="mlsroad-start-") as folder:
        for _ in _processes([f"{folder}/{i % at_once}" for i in range(n_workers)], n_workers, warm_up):
            pass


def _failed(job: SceneJob, cause: str) -> Outcome:
    return Outcome(job.key, 0.0, failure=SceneFailure(job.key, ", ".join(job.task.sources()) or None, cause))


def _run_dask(jobs: Sequence[SceneJob], execution: Execution) -> Generator[Outcome, None, None]:
    """Run scenes on a cluster.

    joblib's own Dask backend waits for ever for a task whose worker was killed, and does not cancel what is in work
    when the caller stops; the client's futures do both right.
    """
    from distributed import as_completed  # noqa: PLC0415  # half a second that only this backend has to pay

    with _dask_client(execution) as client:
        open_jobs: dict[Future, SceneJob] = {}
        waiting = iter(jobs)

        def submit(job: SceneJob) -> Future:
            future = client.submit(run_scene, job, key=f"{job.storage.name}-{job.key}-{job.token}", pure=False)
            open_jobs[future] = job
            return future

        try:
            first = [submit(job) for job in itertools.islice(waiting, execution.n_workers)]
            running = as_completed(first, loop=client.loop)
            for future in running:
                job = open_jobs.pop(future)
                error = future.exception()
                yield future.result() if error is None else _failed(job, describe_error(error))
                running.update([submit(job) for job in itertools.islice(waiting, 1)])
        finally:
            client.cancel(list(open_jobs))


@contextmanager
def _dask_client(execution: Execution) -> Iterator[Client]:
    from distributed import Client, LocalCluster, default_client  # noqa: PLC0415  other backends do without

    if execution.scheduler is not None:
        with Client(execution.scheduler, set_as_default=False) as client:
            yield client
        return
    try:
        current = default_client()
    except ValueError:
        current = None
    if current is not None:
        yield current
        return
    with (
        tempfile.TemporaryDirectory(prefix="mlsroad-dask-") as folder,
        LocalCluster(
            n_workers=execution.n_local_workers,
            threads_per_worker=1,
            memory_limit=0,
            dashboard_address="127.0.0.1:0",  # any free port
            local_directory=folder,
            env={"NUMBA_NUM_THREADS": "1"},
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client
