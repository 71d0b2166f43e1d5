"""Backends that run scenes: this process, processes of this machine, or a Dask cluster."""

import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from typing import Any

import joblib
from joblib.externals.loky import reusable_executor
from joblib.externals.loky.backend.context import set_start_method
from joblib.externals.loky.process_executor import TerminatedWorkerError

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.execution import fork_server
from mlsroad_pipeline.execution.settings import Execution
from mlsroad_pipeline.execution.task import SceneFailure
from mlsroad_pipeline.execution.worker import Outcome, SceneJob, SharedLimit, describe_error, run_scene

MAX_BROKEN_POOLS = 3
"""Number of pools started per stage; the stage fails when a worker of the last one is killed."""

KILLED = (
    "its worker process was killed, also when it ran alone, usually for lack of memory: use shorter scenes or provide "
    "more memory"
)

# One process pool serves all stages of this process; a failed stage ends the pool.
_pool_lock = threading.Lock()
_shared_limit = SharedLimit()


def run_jobs(jobs: Sequence[SceneJob], execution: Execution) -> Generator[Outcome, None, None]:
    """Run scenes and yield their outcomes in order of completion.

    Every job yields exactly one outcome, also if its worker dies. If the caller stops early or is interrupted, running
    scenes are abandoned.
    """
    if execution.backend in ("loky", "dask") and any(job.store.is_private for job in jobs):
        raise ParameterError(f"{jobs[0].store.url}: only the backends sequential and threading reach this memory")
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
    # No memory mapping of large arguments: it would make them read-only, and with this backend only.
    with joblib.parallel_config(n_jobs=n_workers, max_nbytes=None, **config):
        parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch=n_workers)
        yield from parallel(joblib.delayed(function)(job) for job in jobs)


def _run_processes(jobs: Sequence[SceneJob], execution: Execution) -> Generator[Outcome, None, None]:
    """Run scenes in processes; scenes running when a process is killed are repeated, each alone."""
    with _pool_lock:
        waiting = list(jobs)
        suspects: list[SceneJob] = []
        for _ in range(MAX_BROKEN_POOLS):
            started: list[SceneJob] = []
            ended = set()
            try:
                for outcome in _processes(_noted(waiting, started), execution.n_local_workers):
                    ended.add(outcome.key)
                    yield outcome
                waiting = []
                break
            except TerminatedWorkerError:
                suspects += [job for job in started if job.key not in ended]
                waiting = waiting[len(started) :]
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
    if fork_server.is_started():
        set_start_method(fork_server.START_METHOD, force=True)
    # With one worker joblib would run jobs in this process, which must survive a killed scene.
    try:
        yield from _parallel(jobs, max(n_workers, 2), function, backend="loky", inner_max_num_threads=1)
    except (EOFError, ConnectionError) as error:  # the fork server was killed while it started a worker
        raise TerminatedWorkerError("the server of the workers was killed") from error


def _noted(jobs: Sequence[SceneJob], taken: list[SceneJob]) -> Iterator[SceneJob]:
    """Yield jobs, each entered in a list before."""
    for job in jobs:
        taken.append(job)
        yield job


def end_processes() -> None:
    """Kill the process pool, unless a stage uses it; a regular shutdown at exit takes half a second longer."""
    pool = reusable_executor._executor
    if pool is not None and _pool_lock.acquire(blocking=False):
        try:
            pool.shutdown(wait=True, kill_workers=True)
        finally:
            _pool_lock.release()


def _failed(job: SceneJob, cause: str) -> Outcome:
    return Outcome(job.key, 0.0, failure=SceneFailure(job.key, ", ".join(job.task.sources()) or None, cause))


def _run_dask(jobs: Sequence[SceneJob], execution: Execution) -> Generator[Outcome, None, None]:
    from mlsroad_pipeline.execution.dask_cluster import run_on_cluster  # noqa: PLC0415  # imports Dask, 0.5 s

    for key, outcome, error in run_on_cluster(jobs, execution):
        if outcome is not None:
            yield outcome
        elif error is not None:
            yield _failed(next(job for job in jobs if job.key == key), describe_error(error))
