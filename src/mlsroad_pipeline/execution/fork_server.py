"""Server process that workers of this machine are forked from, so that libraries and kernels are loaded once.

The driver imports the libraries, which it needs too, and forks the server, which loads the kernels. Linux alone has
one; elsewhere each worker loads them by itself. This module imports little, so that the server can start before other
imports of the driver.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec
from multiprocessing import connection, forkserver, resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from mlsroad_pipeline.execution.scratch import scratch_folder

START_METHOD = "forkserver"
"""Start method of loky for workers that the server forks."""

PARENT_INTERVAL = 0.5
"""Seconds between two checks of a loading server that its driver is alive."""

_DRIVER = "MLSROAD_DRIVER"
"""Variable with the number of the driver's process while the server starts."""

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR", "NUMBA")
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in _LIBRARIES}
"""Environment variables that limit libraries to one thread, as loky sets them for its workers."""

_started = _loaded = _is_server = False


def start(preload: str, load_libraries: Callable[[], object] | None = None) -> bool:
    """Start the server, which imports a module before the first fork; return False if this system has none.

    With `load_libraries`, this process calls it and forks the server, unless it has threads that a fork would leave
    behind. The socket lies in the folder of temporary files.
    """
    global _started  # noqa: PLW0603  # multiprocessing has one server per process
    if not sys.platform.startswith("linux"):
        return False
    if not _started:
        main = sys.modules["__main__"]
        if getattr(main, "__spec__", None) is None:
            # Of a script without a name, multiprocessing would run the file in each worker.
            main.__spec__ = ModuleSpec("mlsroad_pipeline.__main__", None)
        forkserver.set_forkserver_preload([preload])
        with no_standard_error():
            resource_tracker.ensure_running()  # it unblocks SIGINT
        os.environ[_DRIVER] = str(os.getpid())
        try:
            with interrupts_blocked(), temporary_files_in(scratch_folder()):
                if load_libraries is not None and _can_fork():
                    _with_one_thread(load_libraries)
                    _fork_server(preload)
                    _fork_tracker()
                else:
                    forkserver.ensure_running()
        except OSError:
            return False
        finally:
            del os.environ[_DRIVER]
        _started = True
    return True


def _can_fork() -> bool:
    """Return whether the process has one thread, and has not imported a Numba that would start several."""
    return threading.active_count() == 1 and "numba" not in sys.modules


def _with_one_thread(function: Callable[[], object]) -> None:
    """Call a function that imports libraries, which get the same limits of threads as in the workers."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        function()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _fork_server(preload: str) -> None:
    """Fork the server of `multiprocessing` from this process; the standard library starts another interpreter."""
    server: Any = forkserver._forkserver  # as in `ForkServer.ensure_running`
    with socket.socket(socket.AF_UNIX) as listener:
        address = connection.arbitrary_address("AF_UNIX")  # type: ignore[attr-defined]  # typeshed lacks it
        listener.bind(address)
        Path(address).chmod(0o600)
        listener.listen()
        alive, ours = os.pipe()
        number = os.fork()
        if number == 0:
            _serve(listener.fileno(), alive, ours, preload)
        os.close(alive)
    server._forkserver_address, server._forkserver_alive_fd, server._forkserver_pid = address, ours, number


def _fork_tracker() -> None:
    """Fork the process in which loky tracks semaphores: as another interpreter it would import joblib, 0.2 s."""
    from joblib.externals.loky.backend import resource_tracker as of_loky  # noqa: PLC0415  # the libraries hold it

    tracker: Any = of_loky._resource_tracker
    if tracker._fd is not None:
        return
    reading, writing = os.pipe()
    number = os.fork()
    if number == 0:
        try:
            os.close(writing)
            os.close(forkserver._forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]  # of the driver alone
            with open(os.devnull, "w") as nowhere:  # it prints warnings of killed processes
                os.dup2(nowhere.fileno(), 2)
            of_loky.main(reading)
        finally:
            os._exit(0)
    os.close(reading)
    tracker._fd, tracker._pid = writing, number


def _serve(listener: int, alive: int, drivers: int, preload: str) -> NoReturn:
    """Run the server in a forked process, without what the driver has set up for itself."""
    global _is_server  # noqa: PLW0603  # `load` reads it
    _is_server = True
    try:
        os.close(drivers)  # its end ends the server
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        sys.excepthook = sys.__excepthook__
        for logger in (logging.root, *map(logging.getLogger, logging.root.manager.loggerDict)):
            logger.handlers.clear()
        forkserver.main(listener, alive, [preload])
    finally:
        os._exit(0)  # without the driver's functions at exit


def stop() -> None:
    """Kill the server and the workers that it forked, as for a command that fails before it needs them.

    Otherwise a worker that is being forked while this process ends would print a traceback.
    """
    number = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]  # there is no public name
    if number is None:
        return
    import psutil  # noqa: PLC0415  # commands that succeed need no psutil here

    with suppress(psutil.Error):
        server = psutil.Process(number)
        server.suspend()  # it forks no other worker
        for worker in server.children(recursive=True):
            with suppress(psutil.Error):
                worker.kill()
        server.kill()


def is_started() -> bool:
    """Return whether this process has started the server."""
    return _started


def is_loaded() -> bool:
    """Return whether this process is a worker whose server has loaded libraries and kernels."""
    return _loaded


@contextmanager
def no_standard_error() -> Iterator[None]:
    """Give processes that are started meanwhile no standard error: trackers print warnings of killed processes."""
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


@contextmanager
def temporary_files_in(folder: Path) -> Iterator[None]:
    """Make multiprocessing create the folder of its sockets below another one, which is removed after a kill."""
    before = tempfile.tempdir
    tempfile.tempdir = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block SIGINT; a process that is started meanwhile, and its children, leave Ctrl-C to their driver."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def load(function: Callable[[], object]) -> None:
    """Call a function that loads libraries and kernels, in the server alone; end the server if its driver ends.

    Loaded objects are left out of garbage collection, which would copy the memory that workers share. An error is left
    to the workers, which call the function again.
    """
    global _loaded  # noqa: PLW0603  # the workers inherit it
    if not _is_server and not any("multiprocessing.forkserver" in argument for argument in sys.orig_argv):
        return
    os.environ.update(ONE_THREAD)
    driver = int(os.environ.pop(_DRIVER, os.getppid()))

    def check(number: int, frame: FrameType | None) -> None:
        if os.getppid() != driver:
            os._exit(1)

    before = signal.signal(signal.SIGALRM, check)
    signal.setitimer(signal.ITIMER_REAL, PARENT_INTERVAL, PARENT_INTERVAL)
    gc.disable()  # imports create many objects and no garbage
    try:
        with suppress(Exception):
            function()
            _loaded = True
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    gc.freeze()
