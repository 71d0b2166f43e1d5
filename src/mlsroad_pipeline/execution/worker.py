"""Worker: one scene is read, computed, validated and stored, with one thread."""

import functools
import gc
import importlib
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

from joblib.externals.loky import process_executor
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.execution import fork_server
from mlsroad_pipeline.execution.fingerprints import installation
from mlsroad_pipeline.execution.shared_values import load_shared
from mlsroad_pipeline.execution.store import Record, SceneStore
from mlsroad_pipeline.execution.task import SceneFailure, SceneTask, load_inputs

PARENT_INTERVAL = 0.5
"""Seconds between two checks of a worker process that its driver is alive."""


@dataclass(frozen=True)
class SceneJob:
    """Job of a worker."""

    key: str  # The scene
    task: SceneTask  # The task
    fingerprint: str  # Fingerprint of the task, stored with the result
    store: SceneStore  # Destination of the result
    token: str  # Token of the run, from `SceneStore.begin`
    backend: str  # Backend of the worker; see `Execution`
    validator: str | None = None  # Dotted name of a function that checks the result
    # `fingerprints.installation` of the driver, which a worker on another machine must share; empty for workers of this
    # machine
    installation: str = ""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job: a record of the stored result or a failure."""

    key: str  # The scene
    seconds: float  # Elapsed time, including reading and storing
    record: Record | None = None  # Record of the stored result
    failure: SceneFailure | None = None  # The failure, if nothing was stored


def import_function(name: str, role: str) -> Callable[..., Any]:
    """Return the function with a dotted name, or raise ParameterError naming its role and what is wrong."""
    module, _, function = name.rpartition(".")
    try:
        imported = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ParameterError(f"{role} {name!r} cannot be imported: {error}") from error
    if not callable(imported):
        raise ParameterError(f"{role} {name!r} is not a function")
    return cast(Callable[..., Any], imported)


def run_scene(job: SceneJob) -> Outcome:
    """Load the inputs of a scene, call its function, validate and store the result."""
    start = time.perf_counter()
    sources = job.task.sources()
    try:
        if job.installation:
            _check_installation(job.installation)
        job.store.check_held(job.token)
        if job.backend == "loky":
            _settle()
        with _one_inner_thread(job.backend):
            inputs = load_inputs(job.task.inputs)
            sources = sources or [value.source for value in inputs.values() if isinstance(value, PointCloud)]
            result = job.task.function(**inputs, **load_shared(job.task.parameters))
            del inputs
            if job.validator is not None:
                import_function(job.validator, "validator")(result)
        record = job.store.commit(job.key, job.fingerprint, result, token=job.token)
    except Exception as error:
        text = "".join(traceback.format_exception(error))
        failure = SceneFailure(job.key, ", ".join(dict.fromkeys(sources)) or None, describe_error(error), text)
        return Outcome(job.key, time.perf_counter() - start, failure=failure)
    return Outcome(job.key, time.perf_counter() - start, record=record)


def _check_installation(expected: str) -> None:
    """Raise ParameterError if this worker would compute other results than the driver's fingerprints stand for."""
    own = installation()
    if own != expected:
        raise ParameterError(
            f"the worker on {socket.gethostname()} has {own}, this run {expected}: install the same version of "
            "mlsroad_pipeline and of its packages there, and restart the worker"
        )


@functools.lru_cache(maxsize=1)
def _settle() -> None:
    """Bind the lifetime of a process of loky to that of its driver, which alone handles Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_driver()
    # The leak detection of loky would replace a worker with a large scene by a cold one.
    process_executor._MAX_MEMORY_LEAK_SIZE = sys.maxsize
    gc.enable()  # the server of the workers has disabled it


def _end_with_driver() -> None:
    """End this worker soon after its driver; it would otherwise keep its memory for minutes."""
    driver, parent = multiprocessing.parent_process(), os.getppid()

    def watch() -> None:
        if driver is not None and driver.pid != parent:  # this worker is a child of the fork server
            driver.join()
        else:
            while os.getppid() == parent:
                time.sleep(PARENT_INTERVAL)
        os._exit(1)

    threading.Thread(target=watch, name="end-with-driver", daemon=True).start()


def describe_error(error: BaseException) -> str:
    """Return type and message of an error, with its place in the code unless it is an error of this package."""
    text = f"{type(error).__name__}: {error}"
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, MlsRoadError) or not frames:
        return text
    return f"{text} ({os.path.basename(frames[-1].filename)}:{frames[-1].lineno}, in {frames[-1].name})"


@functools.lru_cache(maxsize=1)
def _limit_to_one_thread() -> None:
    """Limit the libraries of a process that runs scenes only to one thread, also those loaded later."""
    os.environ.update(fork_server.ONE_THREAD)
    threadpool_limits(1)
    numba = importlib.import_module("numba") if "numba" in sys.modules else None
    # Without need it would create a semaphore that a killed worker leaves behind.
    if numba is not None and numba.config.NUMBA_NUM_THREADS > 1:
        numba.set_num_threads(1)


@contextmanager
def _one_inner_thread(backend: str) -> Iterator[None]:
    """Limit libraries to one thread inside a scene, since the workers occupy all cores."""
    if backend in ("loky", "dask"):  # a process that runs scenes only
        _limit_to_one_thread()
    if backend == "loky":  # it runs scenes in its main thread
        yield
        return
    # Import Numba only if it is loaded or being loaded by another thread; the import waits for that thread.
    numba = importlib.import_module("numba") if "numba" in sys.modules else None
    before = None if numba is None else numba.get_num_threads()
    if numba is not None:
        numba.set_num_threads(1)
    try:
        # OpenMP settings are per thread: the limit of the process does not apply to the threads of a pool.
        with threadpool_limits(1, user_api="openmp"):
            yield
    finally:
        if numba is not None and before is not None:
            numba.set_num_threads(before)


class SharedLimit:
    """Limit of one BLAS and OpenMP thread for this process while at least one stage runs in it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._limits: threadpool_limits | None = None

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Limit the threads until the last holder leaves."""
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
