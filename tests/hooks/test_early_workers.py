"""Early workers of `label`: which commands start them, and that the stages run in them."""

import gc
import os
import subprocess
import sys
from contextlib import suppress

import psutil
import pytest

from mlsroad_pipeline.execution.settings import Execution
from mlsroad_pipeline.hooks import early_workers
from mlsroad_pipeline.hooks.early_workers import EarlyWorkersHooks, execution_of


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["/venv/bin/kedro", "run", "--pipelines=label"], Execution()),
        (["python -m kedro", "run", "--pipeline", "label", "--env=oakland"], Execution()),
        (["kedro", "run", "--pipeline=label"], Execution()),
        (["/site/mlsroad_pipeline/__main__.py", "-p", "label"], Execution()),
        (["kedro", "run", "--pipelines=label", "--params=a=1,execution.n_workers=3"], Execution(n_workers=3)),
        (["kedro", "run", "--pipelines=label", "--params=execution.n_workers=0"], Execution()),
        (["kedro", "run", "--pipelines=label", "--params=execution.backend=threading"], None),
        (["kedro", "run", "--pipelines=label", "--params=execution.backend=dask"], Execution("dask")),
        (
            ["kedro", "run", "--pipelines=label", "--params=execution.backend=dask,execution.n_workers=2"],
            Execution("dask", 2),
        ),
        (
            ["kedro", "run", "--pipelines=label", "--params=execution.backend=dask,execution.scheduler=tcp://h:1"],
            Execution("dask", None, "tcp://h:1"),
        ),
        (["kedro", "run", "--pipelines=labels"], None),
        (["kedro", "run", "--params=label.survey=label"], None),
        (["kedro", "catalog", "list", "--pipelines=label"], None),
        (["/venv/bin/pytest", "run", "--pipelines=label"], None),
        (["kedro", "run"], None),
        ([], None),
    ],
)
def test_only_label_with_processes_starts_them(arguments, expected):
    assert execution_of(arguments) == expected


def test_other_commands_start_nothing_and_change_nothing(monkeypatch):
    monkeypatch.setattr(early_workers.threading, "Thread", None)  # a start would fail
    hooks = EarlyWorkersHooks(["kedro", "run"])
    assert gc.isenabled()
    gc.disable()
    try:
        hooks.before_pipeline_run()
        assert not gc.isenabled()
    finally:
        gc.enable()
    hooks.after_pipeline_run()
    hooks.on_pipeline_error()


def test_workers_of_a_scheduler_elsewhere_are_not_started(monkeypatch):
    monkeypatch.setattr(early_workers.threading, "Thread", None)  # a start would fail
    setting = "--params=execution.backend=dask,execution.scheduler=tcp://h:1"
    try:
        hooks = EarlyWorkersHooks(["kedro", "run", "--pipelines=label", setting])
        assert not gc.isenabled()
        hooks.before_pipeline_run()
        assert gc.isenabled()
    finally:
        gc.enable()
        gc.unfreeze()
    hooks.after_pipeline_run()


def test_an_error_ends_the_workers_too(monkeypatch):
    ended = []
    hooks = EarlyWorkersHooks([])
    monkeypatch.setattr(hooks, "_end", lambda: ended.append("ended"))
    hooks.after_pipeline_run()
    hooks.on_pipeline_error()
    assert ended == ["ended", "ended"]


SCRIPT = """
import gc, os, sys
from joblib.externals.loky.backend import resource_tracker
from mlsroad_pipeline.execution import fork_server
from mlsroad_pipeline.execution.backends import _processes
from mlsroad_pipeline.hooks.early_workers import EarlyWorkersHooks

def loaded(number):
    return os.getpid(), fork_server.is_loaded() and gc.isenabled()

def alive(pid):
    return os.path.exists(f"/proc/{pid}") and open(f"/proc/{pid}/stat").read().split()[2] != "Z"

hooks = EarlyWorkersHooks(["kedro", "run", "--pipelines=label", "--params=execution.n_workers=2"])
print(not gc.isenabled() and not fork_server.is_loaded())
hooks.before_pipeline_run()
print(gc.isenabled())
hooks._thread.join()
results = list(_processes(range(4), 2, loaded))
pids = {pid for pid, _ in results}
print(os.getpid() not in pids, all(warm for _, warm in results))
hooks.after_pipeline_run()
print(not any(map(alive, pids)))
tracker = resource_tracker._resource_tracker._pid
print(open(f"/proc/{tracker}/cmdline").read() == open("/proc/self/cmdline").read(), tracker)
"""


def test_stages_get_the_workers_that_were_started_early():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=dict(os.environ), check=False, timeout=300
    )
    assert done.stdout.split()[:6] == ["True"] * 6, done.stderr
    tracker = int(done.stdout.split()[6])
    with suppress(psutil.NoSuchProcess):
        psutil.Process(tracker).wait(10)
    assert not psutil.pid_exists(tracker)
    assert "leaked" not in done.stderr  # warning of a tracker of semaphores


DASK = """
import os, sys, threading
from mlsroad_pipeline.hooks.early_workers import EarlyWorkersHooks

def state(number):
    from mlsroad_pipeline.execution import fork_server
    main = threading.current_thread() is threading.main_thread()
    return os.getpid(), fork_server.is_loaded() and main and os.environ["OMP_NUM_THREADS"] == "1"

def exists(pid):
    return os.path.exists(f"/proc/{pid}") and open(f"/proc/{pid}/stat").read().split()[2] != "Z"

setting = "--params=execution.backend=dask,execution.n_workers=2"
hooks = EarlyWorkersHooks(["kedro", "run", "--pipelines=label", setting])
hooks.before_pipeline_run()
hooks._thread.join()
from mlsroad_pipeline.execution.local_cluster import _clusters, kept_cluster
(first,) = _clusters
with kept_cluster(2) as cluster:
    cluster.client.wait_for_workers(2, timeout=60)
    results = cluster.client.gather(cluster.client.map(state, range(4)))
print(cluster is first, {pid for pid, _ in results} <= set(cluster.workers.pids), all(warm for _, warm in results))
hooks.after_pipeline_run()
print(not any(map(exists, cluster.workers.pids)), not _clusters)
"""


def test_stages_get_the_dask_workers_that_were_started_early():
    done = subprocess.run(
        [sys.executable, "-c", DASK], capture_output=True, text=True, env=dict(os.environ), check=False, timeout=300
    )
    assert done.stdout.split() == ["True"] * 5, done.stderr
    assert done.stderr == ""
