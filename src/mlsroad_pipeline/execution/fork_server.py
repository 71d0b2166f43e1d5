"""Server process that workers of this machine are forked from, so that libraries and kernels are loaded once.

The driver imports the libraries, which it needs too, and forks the server, which loads the kernels while the driver
goes on. Linux alone has one; elsewhere each worker loads libraries and kernels in its first scene.

Measured gain: `mlsroad label` on 30,000 points and two cores takes 12.1 s, and 20.0 s without the server. With the
server of the standard library, which is another interpreter, it takes 13.1 s (medians of 4 alternating runs).
"""

import ctypes
import gc
import logging
import os
import signal
import socket
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec
from multiprocessing import connection, forkserver, resource_tracker
from pathlib import Path
from typing import Any, NoReturn

from mlsroad_pipeline.execution.scratch import scratch_folder

START_METHOD = "forkserver"
"""Start method of loky for workers that the server forks."""

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR", "NUMBA")
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in _LIBRARIES}
"""Environment variables that limit libraries to one thread, as loky sets them for its workers."""

_END_WITH_PARENT = 1
"""Option of prctl: the signal that a process gets when its parent ends."""

_started = False


def start(load_libraries: Callable[[], object], load_kernels: Callable[[], object]) -> bool:
    """Import libraries in this process, fork the server from it, and load kernels there; return whether it runs.

    There is no server on another system than Linux, in a process with threads, which a fork would leave behind, or
    where the folder of temporary files takes no socket: its path must be shorter than 108 bytes.
    """
    global _started  # noqa: PLW0603  # multiprocessing has one server per process
    if _started:
        return True
    if not sys.platform.startswith("linux") or threading.active_count() > 1:
        return False
    main = sys.modules["__main__"]
    if getattr(main, "__spec__", None) is None:
        # Of a script without a name, multiprocessing would run the file in each worker.
        main.__spec__ = ModuleSpec("mlsroad_pipeline.__main__", None)
    _with_one_thread(load_libraries)
    try:
        with _interrupts_blocked(), _temporary_files_in(scratch_folder()):
            _fork_server(load_kernels)
    except OSError:
        return False
    with _no_standard_error():  # after a kill, trackers print warnings of semaphores
        from joblib.externals.loky.backend import resource_tracker as of_loky  # noqa: PLC0415  # the libraries hold it

        resource_tracker.ensure_running()
        of_loky.ensure_running()
    _started = True
    return True


def is_started() -> bool:
    """Return whether this process has started the server."""
    return _started


@contextmanager
def beside(function: Callable[[], object]) -> Iterator[None]:
    """Call a function in a process forked from the server while the body runs, and wait for it.

    Side by side, two processes compile the kernels of a first run; each then loads those of the other.
    """
    server, number = os.getpid(), os.fork()
    if number == 0:
        try:
            ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
            if os.getppid() == server:
                function()
        except Exception:  # the process ends before Python would print it
            traceback.print_exc()
        finally:
            os._exit(0)
    try:
        yield
    finally:
        os.waitpid(number, 0)


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


def _fork_server(load_kernels: Callable[[], object]) -> None:
    """Fork the server of `multiprocessing` from this process; the standard library starts another interpreter."""
    server: Any = forkserver._forkserver  # as in `ForkServer.ensure_running`
    with socket.socket(socket.AF_UNIX) as listener:
        address = connection.arbitrary_address("AF_UNIX")  # type: ignore[attr-defined]  # typeshed lacks it
        listener.bind(address)
        Path(address).chmod(0o600)
        listener.listen()
        alive, ours = os.pipe()
        driver, number = os.getpid(), os.fork()
        if number == 0:
            os.close(ours)  # its end ends the server
            _serve(listener.fileno(), alive, driver, load_kernels)
        os.close(alive)
    server._forkserver_address, server._forkserver_alive_fd, server._forkserver_pid = address, ours, number


def _serve(listener: int, alive: int, driver: int, load_kernels: Callable[[], object]) -> NoReturn:
    """Run the server in a forked process, without what the driver has set up for itself."""
    try:
        ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != driver:
            os._exit(1)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        sys.excepthook = sys.__excepthook__
        for logger in (logging.root, *map(logging.getLogger, logging.root.manager.loggerDict)):
            logger.handlers.clear()
        os.environ.update(ONE_THREAD)
        gc.disable()  # imports create many objects and no garbage
        with suppress(Exception):  # the first scene raises it
            sys.modules["numba"].config.reload_config()  # the driver may have imported it before
            load_kernels()
        gc.freeze()  # collection would copy the memory that workers share
        forkserver.main(listener, alive, [])
    finally:
        os._exit(0)  # without the driver's functions at exit


@contextmanager
def _no_standard_error() -> Iterator[None]:
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Make multiprocessing create the folder of its sockets below another one, which is removed after a kill."""
    before = tempfile.tempdir
    tempfile.tempdir = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT; a process that is started meanwhile, and its children, leave Ctrl-C to their driver."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
