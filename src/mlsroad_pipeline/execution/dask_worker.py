"""Worker process of the Dask cluster of this machine: scenes run in its main thread, communication in another."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import dask
from distributed import Security, Worker

from mlsroad_pipeline.execution.fork_server import temporary_files_in
from mlsroad_pipeline.execution.worker import settle

SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.http.routes": [],
    "distributed.worker.use-file-locking": False,
    "distributed.scheduler.http.routes": [],
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.diagnostics.nvml": False,
}
"""Configuration of scheduler and workers without samples of stacks, dashboards and frequent measurements, which take
processor time from the scenes."""

CONNECT_SECONDS = 60
"""Longest wait for the scheduler."""


class MainThread(Executor):
    """Executor whose calls run in the thread that calls `run`.

    In the main thread, memory comes from the main arena of the C library and is kept for the next scene, as in the
    processes of loky; other threads return it to the system after each array and fault it in again.
    """

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Queue a call."""
        future: Future[Any] = Future()
        self._calls.put((future, lambda: function(*args, **kwargs)))
        return future

    def run(self) -> None:
        """Run the calls until the shutdown."""
        while (item := self._calls.get()) is not None:
            future, call = item
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(call())
            except BaseException as error:
                future.set_exception(error)
            del item, future, call  # results would stay in memory until the next call

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End `run` after the calls queued so far."""
        self._calls.put(None)


def serve(scheduler: str, security: Security, folder: str, host: str | None) -> None:
    """Run a worker until its scheduler or its driver ends; raise no error if the scheduler cannot be reached."""
    settle()
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the driver logs what is lost
    dask.config.set(SETTINGS)
    calls = MainThread()

    async def work() -> None:
        worker = Worker(
            scheduler,
            nthreads=1,
            executor=calls,
            memory_limit=0,
            host=host,
            dashboard_address="127.0.0.1:0",
            death_timeout=CONNECT_SECONDS,
            security=security,
            local_directory=folder,
        )
        with temporary_files_in(Path(folder)):  # it writes its certificate for a moment
            await worker
        await worker.finished()

    def communicate() -> None:
        try:
            asyncio.run(work())
        finally:
            os._exit(0)

    threading.Thread(target=communicate, name="dask-worker", daemon=True).start()
    gc.freeze()
    gc.enable()
    calls.run()
