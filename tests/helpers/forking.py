"""Processes of `mlsroad` that are forked from one that has imported it: each its own, without the seconds of the imports.

A command starts with the modules of `label` loaded; what it loads by itself is tested with a process from the start.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LOADED = (
    "mlsroad_pipeline.commands.session",
    "mlsroad_pipeline.commands.console",
    "mlsroad_pipeline.label.warm_up",
    "mlsroad_pipeline.pipelines.label.pipeline",
    "mlsroad_pipeline.pipelines.inspect",
    "kedro.framework.context",
    "kedro.runner",
)


class Commands:
    """Process that forks one process per command."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self._folder, self._environment = folder, dict(environment)
        self._server = subprocess.Popen(
            [sys.executable, __file__], cwd=folder, env=self._environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True,
        )  # fmt: skip

    def run(self, arguments: Sequence[str], cwd: Path) -> subprocess.CompletedProcess[str]:
        """Run `mlsroad` with arguments in a folder; neither stdout nor stderr is a terminal."""
        out, err = self._folder / "stdout", self._folder / "stderr"
        request = {"arguments": list(arguments), "cwd": str(cwd), "stdout": str(out), "stderr": str(err)}
        assert self._server.stdin is not None and self._server.stdout is not None
        self._server.stdin.write(json.dumps(request) + "\n")
        self._server.stdin.flush()
        code = int(self._server.stdout.readline())
        return subprocess.CompletedProcess(list(arguments), code, out.read_text(), err.read_text())

    def close(self) -> None:
        """End the process."""
        self._server.communicate()


@contextmanager
def forked_commands(folder: Path, environment: Mapping[str, str]) -> Iterator[Commands]:
    """Start the process with an environment, and end it; `folder` takes what the commands print."""
    commands = Commands(folder, environment)
    try:
        yield commands
    finally:
        commands.close()


def _next_request() -> dict[str, Any] | None:
    """Fork at each request and report its exit code; return the request in the child, and None at the end of stdin."""
    while line := sys.stdin.readline():
        child = os.fork()
        if child == 0:
            return dict(json.loads(line))
        sys.stdout.write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\n")
        sys.stdout.flush()
    return None


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
    gc.freeze()  # the memory stays shared
    given = _next_request()
    if given is not None:
        _become(given)
        main()
