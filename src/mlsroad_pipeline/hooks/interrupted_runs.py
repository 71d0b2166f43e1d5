"""Status of runs that were interrupted: KILLED, in place of FINISHED after Ctrl-C and RUNNING after a kill."""

import atexit
import os
import signal
import socket
import threading
from collections.abc import Callable

import mlflow
import psutil

PROCESS = "mlsroad.process"
"""Tag of a run: host, number and start of its process."""

_CLOCK_STEP = 60.0
"""Seconds by which the start of a process may seem to move: Linux derives it from the clock."""

_MOST = 1000
"""Most runs that are checked; those of a store that never ended are few."""


def this_process() -> str:
    """Return the value of the tag for this process."""
    return f"{socket.gethostname()} {os.getpid()} {psutil.Process().create_time():.2f}"


def close_stale_runs(experiment_id: str) -> int:
    """Mark runs of processes of this host that have ended as KILLED; return their number."""
    client = mlflow.MlflowClient()
    running = client.search_runs([experiment_id], "attributes.status = 'RUNNING'", max_results=_MOST)
    stale = [run for run in running if _has_ended(run.data.tags.get(PROCESS, ""))]
    for run in stale:
        client.set_terminated(run.info.run_id, "KILLED")
    return len(stale)


def _has_ended(process: str) -> bool:
    """Return whether the process of a tag ran on this host and is gone; its number may be that of another by now."""
    host, _, rest = process.partition(" ")
    if host != socket.gethostname():
        return False
    number, _, start = rest.partition(" ")
    try:
        return abs(psutil.Process(int(number)).create_time() - float(start)) > _CLOCK_STEP
    except psutil.NoSuchProcess:
        return True
    except (ValueError, psutil.Error):  # no tag of this program, or a process that may not be inspected
        return False


def at_exit(end: Callable[[], None]) -> None:
    """Call a function when this process ends, before MLflow ends its run; SIGTERM ends it like Ctrl-C."""
    atexit.register(end)
    in_main = threading.current_thread() is threading.main_thread()
    if in_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
