"""Early start of the workers of `label`, while the driver is still importing its libraries.

Before the first scene of `kedro run --pipelines=label`, the driver imports Kedro and libraries and reads the
configuration, and the workers need libraries and compiled kernels. With the early start both happen at the same time.
Kedro calls no hook of a project before its settings are imported, so the settings start the workers, and the command
line shows whether they are needed.
"""

from __future__ import annotations

import atexit
import gc
import re
import sys
import threading
from collections.abc import Sequence

from kedro.framework.hooks import hook_impl

from mlsroad_pipeline.execution import fork_server
from mlsroad_pipeline.execution.settings import Execution

WARM_UP = "mlsroad_pipeline.label.warm_up.run_stages"
"""Function that the workers call first, unless their server has called it."""
PRELOADED = "mlsroad_pipeline.label.preloaded"
"""Module that the fork server of the workers imports first."""

_PIPELINE = re.compile(r"(?:--pipelines?[= ]|-p ?)label(?: |$)")
_WORKERS = re.compile(r"--workers[= ](\d+)")
_SETTING = re.compile(r"execution\.(backend|n_workers|scheduler)=([^,\s]+)")


def execution_of(arguments: Sequence[str]) -> Execution | None:
    """Return the execution settings of a command line that runs `label` in processes, None for other commands."""
    # /usr/bin/kedro, "python -m kedro", mlsroad_pipeline/__main__.py or mlsroad
    program = set(re.split(r"[\s/\\]+", arguments[0])) if arguments else set()
    line = " ".join(arguments)
    is_command = "mlsroad" in program and arguments[1:2] == ["label"]
    if not is_command and "mlsroad_pipeline" not in program and not ("kedro" in program and "run" in arguments):
        return None
    settings = dict(_SETTING.findall(line))
    if not (is_command or _PIPELINE.search(line)) or settings.get("backend", "loky") not in ("loky", "dask"):
        return None
    n_workers = "".join(_WORKERS.findall(line)[-1:]) or settings.get("n_workers", "")
    n_processes = int(n_workers) if re.fullmatch("[1-9][0-9]*", n_workers) else None
    backend = settings.get("backend", "loky")
    return Execution(backend, n_processes, settings.get("scheduler") if backend == "dask" else None)


def _load_libraries() -> None:
    """Load the libraries that driver and workers share."""
    from mlsroad_pipeline.label.warm_up import load_first_kernel  # noqa: PLC0415  # other commands need none of them

    load_first_kernel()


def _load_libraries_and_dask() -> None:
    """Load the libraries and Dask, which driver and workers share."""
    _load_libraries()
    import mlsroad_pipeline.execution.local_cluster  # noqa: F401, PLC0415  # loky needs no Dask


class EarlyWorkersHooks:
    """Start the workers of `label` on construction, and end them with the run.

    Other commands start nothing. Until the pipeline begins, garbage collection is off in the driver: imports create
    many objects and no garbage, and collection takes a quarter of their time.
    """

    def __init__(self, arguments: Sequence[str] | None = None) -> None:
        self._thread: threading.Thread | None = None
        self._ended, self._collects = False, True
        execution = execution_of(sys.argv if arguments is None else arguments)
        if execution is None:
            return
        gc.disable()
        self._collects = False
        if execution.scheduler is not None:  # its workers run already
            return
        self._backend = execution.backend
        fork_server.start(PRELOADED, _load_libraries_and_dask if self._backend == "dask" else _load_libraries)
        from mlsroad_pipeline.execution.backends import warm_workers  # noqa: PLC0415  # other commands need no joblib yet

        self._thread = threading.Thread(
            target=warm_workers, args=(execution, WARM_UP), name="start-workers", daemon=True
        )
        self._thread.start()
        atexit.register(self._end_unused)

    @hook_impl(trylast=True)
    def before_pipeline_run(self) -> None:
        """Switch garbage collection on again, except for the objects created so far."""
        if not self._collects and not gc.isenabled():
            gc.freeze()
            gc.enable()

    @hook_impl(trylast=True)
    def after_pipeline_run(self) -> None:
        """End the workers."""
        self._end()

    @hook_impl(trylast=True)
    def on_pipeline_error(self) -> None:
        """End the workers."""
        self._end()

    def _end(self) -> None:
        """Kill the workers; a regular shutdown takes half a second longer."""
        if self._thread is None:
            return
        self._thread.join()
        if self._backend == "dask":
            from mlsroad_pipeline.execution.local_cluster import close  # noqa: PLC0415  # loky needs no Dask

            close()
        else:
            from joblib.externals.loky import get_reusable_executor  # noqa: PLC0415  # this module is imported first

            get_reusable_executor(reuse=True, kill_workers=True).shutdown(wait=True, kill_workers=True)
        self._ended = True

    def _end_unused(self) -> None:
        """Kill the workers of a command that failed before its pipeline began, such as for a misspelt parameter."""
        if not self._ended:
            fork_server.stop()
