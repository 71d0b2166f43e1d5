"""Workers of `label` that start with the command: for which commands, and that the stages get them, warm."""

import gc
import os
import subprocess
import sys
import threading

import pytest

from mlsroad_pipeline.execution.settings import Execution
from mlsroad_pipeline.hooks import command_hooks
from mlsroad_pipeline.hooks.command_hooks import EarlyWorkersHooks
from mlsroad_pipeline.hooks.early_workers import start_early, wanted


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["/venv/bin/kedro", "run", "--pipeline=label"], Execution()),
        (["python -m kedro", "run", "--pipeline", "label", "--env=oakland"], Execution()),
        (["/site/mlsroad_pipeline/__main__.py", "-p", "label"], Execution()),
        (["kedro", "run", "--pipelines=label", "--params=a=1,execution.n_workers=3"], Execution(n_workers=3)),
        (["kedro", "run", "--pipeline=label", "--params=execution.n_workers=0"], Execution()),
        (["kedro", "run", "--pipeline=label", "--params=execution.backend=threading"], None),
        (["kedro", "run", "--pipeline=labels"], None),
        (["kedro", "run", "--params=label.survey=label"], None),
        (["kedro", "catalog", "list", "--pipeline=label"], None),
        (["/venv/bin/pytest", "run", "--pipeline=label"], None),
        (["kedro", "run"], None),
        ([], None),
    ],
)
def test_only_label_with_processes_starts_them(arguments, expected):
    assert wanted(arguments) == expected


def test_other_commands_start_nothing():
    assert start_early(["kedro", "run"]) is None


def test_a_pipeline_ends_the_start_and_its_end_or_its_error_the_workers(monkeypatch):
    ended = []
    monkeypatch.setattr(command_hooks, "end_workers", ended.append)
    thread = threading.Thread()
    gc.disable()
    try:
        EarlyWorkersHooks(None).before_pipeline_run()
        assert not gc.isenabled()  # it is not for commands that started nothing to turn it on
        EarlyWorkersHooks(thread).before_pipeline_run()
        assert gc.isenabled()
    finally:
        gc.enable()
        gc.unfreeze()
    for hooks in (EarlyWorkersHooks(None), EarlyWorkersHooks(thread)):
        hooks.after_pipeline_run()
        hooks.on_pipeline_error()
    assert ended == [thread, thread]


SCRIPT = """
import gc, os, sys
from mlsroad_pipeline.execution.backends import _processes
from mlsroad_pipeline.hooks.early_workers import end_start, end_workers, start_early

def loaded(number):
    return os.getpid(), "mlsroad_pipeline.label.warm_up" in sys.modules and gc.isenabled()

def alive(pid):
    return os.path.exists(f"/proc/{pid}") and open(f"/proc/{pid}/stat").read().split()[2] != "Z"

thread = start_early(["kedro", "run", "--pipeline=label", "--params=execution.n_workers=2"])
assert "mlsroad_pipeline.label.warm_up" not in sys.modules
print(not gc.isenabled())
end_start()
print(gc.isenabled())
thread.join()
found = list(_processes(range(4), 2, loaded))
pids = {pid for pid, _ in found}
print(os.getpid() not in pids, all(warm for _, warm in found))
end_workers(thread)
print(not any(map(alive, pids)))
"""


def test_stages_get_the_workers_that_were_started_early():
    found = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=dict(os.environ), check=False, timeout=300
    )
    assert found.stdout.split() == ["True"] * 5, found.stderr
