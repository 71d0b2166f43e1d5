"""What happens in a worker: one scene is read, computed, checked and stored, with one thread."""

from __future__ import annotations

import fcntl
import functools
import gc
import importlib
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from joblib.externals.loky import process_executor
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.execution.record import Record
from mlsroad_pipeline.execution.shared_values import load_shared
from mlsroad_pipeline.execution.storage import SceneStorage, SupersededError
from mlsroad_pipeline.execution.task import SceneFailure, SceneTask, load_inputs

PARENT_INTERVAL = 0.5
"""Seconds between two looks of a worker process at whether its driver is alive."""


@dataclass(frozen=True)
class SceneJob:
    """What a worker is given.

    Parameters
    ----------
    key : str
        The scene.
    task : SceneTask
        What to call.
    fingerprint : str
        The task's fingerprint, stored with the result.
    storage : SceneStorage
        Where the result goes.
    token : str
        The run's, from `SceneStorage.begin`.
    backend : str
        Where the worker runs; see `Execution`.
    validator : str, optional
        Dotted name of the check that the result has to pass.
    """

    key: str
    task: SceneTask
    fingerprint: str
    storage: SceneStorage
    token: str
    backend: str
    validator: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What a worker gives back: a record or a failure, never the result.

    Parameters
    ----------
    key : str
        The scene.
    seconds : float
        How long it took, reading and storing included.
    record : Record, optional
        What was stored.
    failure : SceneFailure, optional
        Why nothing was.
    """

    key: str
    seconds: float
    record: Record | None = None
    failure: SceneFailure | None = None


def find_validator(name: str) -> Callable[[Any], object]:
    """Return the function that a dotted name means.

    Raises
    ------
    ParameterError
        If there is no such module or function.
    """
    module, _, function = name.rpartition(".")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ParameterError(f"validator {name!r} cannot be imported: {error}") from error
    if not callable(found):
        raise ParameterError(f"validator {name!r} is not a function")
    return cast(Callable[[Any], object], found)


def run_scene(job: SceneJob) -> Outcome:
    """Load a scene's inputs, call its function, check and store what it returns; this is what runs in a worker."""
    start = time.perf_counter()
    sources = job.task.sources()
    try:
        if not job.storage.is_held(job.token):
            raise SupersededError(f"{job.storage.url}: another run has taken this store over")
        if job.backend == "loky":
            _settle()
        with _one_inner_thread(for_good=job.backend in ("loky", "dask")):
            inputs = load_inputs(job.task.inputs)
            sources = sources or [value.source for value in inputs.values() if isinstance(value, PointCloud)]
            result = job.task.function(**inputs, **load_shared(job.task.parameters))
            del inputs
            if job.validator is not None:
                find_validator(job.validator)(result)
        record = job.storage.commit(job.key, job.fingerprint, result, token=job.token)
    except Exception as error:
        text = "".join(traceback.format_exception(error))
        failure = SceneFailure(job.key, ", ".join(dict.fromkeys(sources)) or None, describe_error(error), text)
        return Outcome(job.key, time.perf_counter() - start, failure=failure)
    return Outcome(job.key, time.perf_counter() - start, record=record)


def _settle() -> None:
    """Tie a process of loky to its driver, and keep it as long as the driver lives."""
    _end_with_parent(os.getppid())
    _keep_worker()


def warm_up(turn: str) -> str:
    """Load the libraries and compiled kernels that labelling a scene takes; runs in a process of loky."""
    _settle()
    with Path(turn).open("w") as stream, _one_inner_thread(for_good=True):
        fcntl.flock(stream, fcntl.LOCK_EX)
        gc.disable()  # nothing that is loaded here is ever unused
        importlib.import_module("mlsroad_pipeline.label.warm_up").run_stages()
        gc.freeze()
        gc.enable()
    return turn


@functools.lru_cache(maxsize=1)
def _end_with_parent(parent: int) -> None:
    """Let this worker end when its driver is gone; it would otherwise stay for minutes and hold its memory."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_INTERVAL)
        os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


@functools.lru_cache(maxsize=1)
def _keep_worker() -> None:
    """Keep loky from taking a scene's memory for a leak: it would end the worker, and the next one begins from cold."""
    process_executor._MAX_MEMORY_LEAK_SIZE = sys.maxsize


def describe_error(error: BaseException) -> str:
    """Return an error's type and message, and its place in the code unless its message is meant to be enough."""
    text = f"{type(error).__name__}: {error}"
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, MlsRoadError) or not frames:
        return text
    return f"{text} ({os.path.basename(frames[-1].filename)}:{frames[-1].lineno}, in {frames[-1].name})"


@contextmanager
def _one_inner_thread(*, for_good: bool) -> Iterator[None]:
    """Keep libraries from starting threads of their own inside a scene: as many scenes as workers run already."""
    if for_good:  # a process that does nothing but scenes
        threadpool_limits(1)
        if "numba" not in sys.modules:
            os.environ["NUMBA_NUM_THREADS"] = "1"
    # Importing what another thread is just importing waits for it; what nobody imports is not brought in here.
    numba = importlib.import_module("numba") if "numba" in sys.modules else None
    before = None if numba is None else numba.get_num_threads()
    if numba is not None:
        numba.set_num_threads(1)
    try:
        # A thread has its own OpenMP setting, so what holds for the process does not reach a pool's threads.
        with threadpool_limits(1, user_api="openmp"):
            yield
    finally:
        if numba is not None and before is not None:
            numba.set_num_threads(before)


class SharedLimit:
    """Holds this process's BLAS and OpenMP at one thread while at least one stage runs in it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._limits: threadpool_limits | None = None

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Limit the threads until the last of those who hold has left."""
        with self._lock:
            self._users += 1
            if self._limits is None:
                self._limits = threadpool_limits(1)
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if self._users == 0 and self._limits is not None:
                    self._limits.restore_original_limits()
                    self._limits = None
