"""Workers that start before the driver has finished its imports.

`kedro run --pipeline=label` spends seconds on Kedro, MLflow and the configuration before it has work for anybody, and a
worker needs seconds for its libraries and compiled kernels. Started with the command, both happen at the same time.
"""

from __future__ import annotations

import gc
import re
import threading
from collections.abc import Sequence

from mlsroad_pipeline.execution.settings import Execution

_PIPELINE = re.compile(r"(?:--pipelines?[= ]|-p ?)label(?: |$)")
_SETTING = re.compile(r"execution\.(backend|n_workers)=(\w+)")


def wanted(arguments: Sequence[str]) -> Execution | None:
    """Tell from a command line whether workers for `label` will be needed, and how many."""
    # /usr/bin/kedro, "python -m kedro" or mlsroad_pipeline/__main__.py
    program = set(re.split(r"[\s/\\]+", arguments[0])) if arguments else set()
    if "mlsroad_pipeline" not in program and not ("kedro" in program and "run" in arguments):
        return None
    line = " ".join(arguments)
    found = dict(_SETTING.findall(line))
    if not _PIPELINE.search(line) or found.get("backend", "loky") != "loky":
        return None
    n_workers = found.get("n_workers", "")
    return Execution(n_workers=int(n_workers) if re.fullmatch("[1-9][0-9]*", n_workers) else None)


def start_early(arguments: Sequence[str]) -> threading.Thread | None:
    """Start the workers of `label` if a command line asks for it; they warm up while this process goes on.

    Until `end_start` is called, unused objects are not looked for.
    """
    execution = wanted(arguments)
    if execution is None:
        return None
    gc.disable()  # imports make many objects and no rubbish: looking for it takes a quarter of their time
    from mlsroad_pipeline.execution.backends import warm_workers  # noqa: PLC0415  # other commands need no joblib yet

    thread = threading.Thread(target=warm_workers, args=(execution,), name="start-workers", daemon=True)
    thread.start()
    return thread


def end_start() -> None:
    """Look for unused objects again, but no more at those that the start has made."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def end_workers(thread: threading.Thread) -> None:
    """End the workers at once: asked to end on their own they take half a second, in which a command would wait."""
    from joblib.externals.loky import get_reusable_executor  # noqa: PLC0415  this module is loaded before all others

    thread.join()
    get_reusable_executor(reuse=True, kill_workers=True).shutdown(wait=True, kill_workers=True)
