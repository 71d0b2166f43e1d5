"""Processes of `mlsroad` that are forked from one that has imported it: each its own, without the seconds of the imports.

A command starts with most modules and with the kernels of `label` loaded, as workers do; what it loads by itself is
tested with a process from the start.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LOADED = (
    "mlsroad_pipeline.commands.session",
    "mlsroad_pipeline.commands.console",
    "mlsroad_pipeline.label.warm_up",
    "mlsroad_pipeline.label.road",
    "mlsroad_pipeline.pipelines.label.pipeline",
    "mlsroad_pipeline.pipelines.inspect",
    "mlsroad_pipeline.pipelines.score",
    "mlsroad_pipeline.pipeline_registry",
    "mlsroad_pipeline.config",
    "mlsroad_pipeline.datasets.inventory_dataset",
    "mlsroad_pipeline.datasets.scene_store_dataset",
    "mlsroad_pipeline.datasets.model_datasets",
    "mlsroad_pipeline.algorithms.models.pool.labeller",
    "mlsroad_pipeline.hooks.default_pipeline",
    "mlsroad_pipeline.hooks.label_run",
    "mlsroad_pipeline.hooks.mlflow_run",
    "mlsroad_pipeline.hooks.origin",
    "mlsroad_pipeline.hooks.plain_logs",
    "mlsroad_pipeline.hooks.progress",
    "mlsroad_pipeline.hooks.stage_costs",
    "kedro.framework.context",
    "kedro.runner",
)

ALONE = ("--params", "execution.backend=sequential")
"""Options of `label` without workers, which start and run all stages once before the survey is read."""


class Commands:
    """Process that forks one process per command."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self._out, self._err = folder / "stdout", folder / "stderr"
        self._server = subprocess.Popen(
            [sys.executable, __file__], cwd=folder, env=dict(environment), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True,
        )  # fmt: skip

    def start(self, arguments: Sequence[str], cwd: Path) -> int:
        """Start `mlsroad` with arguments in a folder and return its process; neither stdout nor stderr is a terminal."""
        request = {"arguments": list(arguments), "cwd": str(cwd), "stdout": str(self._out), "stderr": str(self._err)}
        assert self._server.stdin is not None
        self._server.stdin.write(json.dumps(request) + "\n")
        self._server.stdin.flush()
        return self._number()

    def end(self, arguments: Sequence[str] = ()) -> subprocess.CompletedProcess[str]:
        """Wait for the process that was started, and return what it printed."""
        code = self._number()
        return subprocess.CompletedProcess(list(arguments), code, self._out.read_text(), self._err.read_text())

    def run(self, arguments: Sequence[str], cwd: Path) -> subprocess.CompletedProcess[str]:
        """Run `mlsroad` with arguments in a folder."""
        self.start(arguments, cwd)
        return self.end(arguments)

    def _number(self) -> int:
        assert self._server.stdout is not None
        return int(self._server.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._server.communicate()


@contextmanager
def serving(folder: Path) -> Iterator[Commands]:
    """Start the process outside of any tracked project, and end it; `folder` takes what the commands print."""
    variables = {k: v for k, v in os.environ.items() if not k.startswith(("MLFLOW_", "KEDRO_", "COV_"))}
    commands = Commands(folder, variables)
    try:
        yield commands
    finally:
        commands.close()


def _next_request() -> dict[str, Any] | None:
    """Fork at each request, report process and exit code; return the request in the child, and None at the end of stdin."""
    while line := sys.stdin.readline():
        child = os.fork()
        if child == 0:
            return dict(json.loads(line))
        _answer(child)
        _answer(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    return None


def _answer(number: int) -> None:
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


def _become(request: Mapping[str, Any]) -> None:
    """Turn this process into that of a command."""
    for name, number in (("stdout", 1), ("stderr", 2)):
        os.dup2(os.open(request[name], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.chdir(request["cwd"])
    sys.argv = ["mlsroad", *request["arguments"]]


if __name__ == "__main__":
    import gc
    import importlib

    from mlsroad_pipeline.commands.app import main
    from mlsroad_pipeline.commands.session import find_place

    # As `configure` does; the settings are left to the command, since the hooks read its arguments.
    os.environ["KEDRO_LOGGING_CONFIG"] = str(Path(find_place().configuration, "logging.yml"))
    for module in LOADED:
        importlib.import_module(module)
    assert "mlsroad_pipeline.settings" not in sys.modules
    importlib.import_module("mlsroad_pipeline.label.warm_up").run_stages()
    assert threading.active_count() == 1  # a fork would lose others
    gc.freeze()  # the memory stays shared
    given = _next_request()
    if given is not None:
        _become(given)
        main()
