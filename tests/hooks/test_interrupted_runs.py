"""Status of tracked runs after Ctrl-C, SIGTERM and a kill."""

import subprocess
import sys

import mlflow
import psutil
import pytest
from helpers.wiring import empty_store

from mlsroad_pipeline.hooks.interrupted_runs import PROCESS, close_stale_runs, this_process
from mlsroad_pipeline.hooks.mlflow_run import MlflowDetailsHooks


def ended_process():
    """Return the tag of a process that has ended, with the number of a living one."""
    host, _, _ = this_process().split()
    return f"{host} {psutil.Process().ppid()} 1000.00"


@pytest.fixture
def tracking_store(tmp_path):
    (tmp_path / "mlflow.db").write_bytes(empty_store())
    before = mlflow.get_tracking_uri()
    mlflow.set_tracking_uri(f"sqlite:///{tmp_path / 'mlflow.db'}")
    yield
    mlflow.set_tracking_uri(before)


@pytest.mark.usefixtures("tracking_store")
def test_runs_of_ended_processes_are_killed_and_others_go_on():
    client = mlflow.MlflowClient()
    experiment = client.create_experiment("e")
    host, number, _ = this_process().split()
    tags = {
        "gone": ended_process(),
        "unknown number": f"{host} {2**22 + 1} 1000.00",
        "mine": this_process(),
        "mine, before the clock was set": f"{host} {number} {psutil.Process().create_time() - 3:.2f}",
        "no number": f"{host} ",
        "elsewhere": f"other{host} {number} 1000.00",
    }
    for name, tag in tags.items():
        client.create_run(experiment, run_name=name, tags={PROCESS: tag})
    client.create_run(experiment, run_name="of others")
    assert close_stale_runs(experiment) == 2
    found = {run.info.run_name: run.info.status for run in client.search_runs([experiment])}
    killed = {name for name, status in found.items() if status == "KILLED"}
    assert killed == {"gone", "unknown number"}
    assert set(found.values()) == {"KILLED", "RUNNING"}


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_an_interrupted_process_ends_its_run_first(name):
    script = (
        "import os, signal; from mlsroad_pipeline.hooks.interrupted_runs import at_exit\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell may have switched it off in the background
        f"at_exit(lambda: print('ended')); os.kill(os.getpid(), signal.{name}); signal.pause()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout == "ended\n"
    assert "KeyboardInterrupt" in done.stderr


def test_a_run_that_neither_finished_nor_failed_is_killed(monkeypatch):
    ended = []
    hooks = MlflowDetailsHooks()
    monkeypatch.setattr(mlflow, "end_run", ended.append)
    hooks._end_killed()
    assert ended == []
    hooks._records = type("Records", (), {"finish": staticmethod(ended.append)})
    hooks._end_killed()
    hooks._end_killed()
    assert ended == ["KILLED", "KILLED"]
