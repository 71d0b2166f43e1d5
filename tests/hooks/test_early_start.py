"""Early start of the workers of `label`: which commands start them, and that the stages run in them."""

import os
import subprocess
import sys

import pytest

from mlsroad_pipeline.hooks.early_start import is_label


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["/venv/bin/kedro", "run", "--pipelines=label"], True),
        (["python -m kedro", "run", "--pipeline", "label", "--env=oakland"], True),
        (["kedro", "run", "--pipeline=label"], True),
        (["/site/mlsroad_pipeline/__main__.py", "-p", "label"], True),
        (["kedro", "run", "--pipelines=label", "--params=a=1,execution.n_workers=3"], True),
        (["kedro", "run", "--pipelines=label", "--params=execution.backend=loky"], True),
        (["kedro", "run", "--pipelines=label", "--params=execution.backend=threading"], False),
        (["kedro", "run", "--pipelines=label", "--params=execution.backend=dask,execution.scheduler=tcp://h:1"], False),
        (["/venv/bin/mlsroad", "label", "a.laz", "--workers", "2"], True),
        (["mlsroad", "label", "a.laz", "--params", "execution.backend=sequential"], False),
        (["mlsroad", "inspect", "label"], False),
        (["kedro", "run", "--pipelines=labels"], False),
        (["kedro", "run", "--params=label.survey=label"], False),
        (["kedro", "catalog", "list", "--pipelines=label"], False),
        (["/venv/bin/pytest", "run", "--pipelines=label"], False),
        (["kedro", "run"], False),
        ([], False),
    ],
)
def test_only_label_with_processes_starts_them(arguments, expected):
    assert is_label(arguments) is expected


SCRIPT = """
import gc, os, sys
from mlsroad_pipeline.hooks.early_start import start_workers

def loaded(number):
    kernels = sys.modules["mlsroad_pipeline.label.warm_up"].extract_objects.__module__ in sys.modules
    return os.getpid(), kernels and "mlsroad_pipeline.loaded_in_server" in sys.modules

def alive(pid):
    return os.path.exists(f"/proc/{pid}") and open(f"/proc/{pid}/stat").read().split()[2] != "Z"

import mlsroad_pipeline.label.warm_up as warm_up
run_stages = warm_up.run_stages
def marked():
    run_stages()
    sys.modules["mlsroad_pipeline.loaded_in_server"] = sys
warm_up.run_stages = marked
start_workers()
from mlsroad_pipeline.execution.backends import _processes, end_processes
from mlsroad_pipeline.hooks.label_run import LabelRunHooks
print(not gc.isenabled())
LabelRunHooks().before_pipeline_run()
print(gc.isenabled())
results = list(_processes(range(4), 2, loaded))
pids = {pid for pid, _ in results}
print(os.getpid() not in pids, all(warm for _, warm in results))
end_processes()
print(not any(map(alive, pids)))
"""


def test_stages_get_workers_with_loaded_kernels():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=dict(os.environ), check=False, timeout=300
    )
    assert done.stdout.split() == ["True"] * 5, done.stderr
    assert done.stderr == ""  # no warning of a tracker of semaphores
