"""The Dask cluster of this machine: one for all stages, closed to others, gone with its driver."""

import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
import pytest
from helpers.store import count_marks, make_points, slow_parts, tree_digest

from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution import local_cluster
from mlsroad_pipeline.execution.dask_cluster import run_on_cluster
from mlsroad_pipeline.execution.local_cluster import close, kept_cluster
from mlsroad_pipeline.execution.settings import Execution
from mlsroad_pipeline.execution.task import SceneTask


def store_at(path, **settings):
    return SceneStoreDataset(filepath=str(path), execution={"progress": False, "backend": "dask", **settings})


def tasks(marks, n_scenes=4, pause=0.0):
    return {
        f"s{i}": SceneTask(slow_parts, {}, {"seed": i, "marks": str(marks), "pause": pause}) for i in range(n_scenes)
    }


@pytest.fixture
def marks(tmp_path):
    folder = tmp_path / "marks"
    folder.mkdir()
    return folder


@pytest.fixture(autouse=True)
def _closed_afterwards():
    yield
    close()


def workers(n_workers=2):
    with kept_cluster(n_workers) as cluster:
        cluster.client.wait_for_workers(n_workers, timeout=60)
        return set(cluster.workers.pids)


def test_stages_share_the_workers_until_another_number_or_the_end(tmp_path, marks):
    first = workers()
    store_at(tmp_path / "a", n_workers=2).save(tasks(marks))
    store_at(tmp_path / "b", n_workers=2).save(tasks(marks))
    assert workers() == first
    assert tree_digest(tmp_path / "a") == tree_digest(tmp_path / "b")
    (other,) = workers(1)
    assert not any(map(psutil.pid_exists, first)) and other not in first
    close()
    assert not psutil.pid_exists(other) and not local_cluster._clusters


def test_it_listens_on_the_loopback_interface_only():
    found = []
    for number in (os.getpid(), *workers()):
        opened = psutil.Process(number).net_connections("inet")
        found += [item.laddr.ip for item in opened if item.status == psutil.CONN_LISTEN]
    assert len(found) >= 3 and set(found) == {"127.0.0.1"}


def test_a_killed_worker_is_replaced_and_the_bytes_are_the_same(tmp_path, marks, caplog):
    store_at(tmp_path / "here", backend="sequential").save(tasks(marks, 8))
    before = workers()
    timer = threading.Timer(0.5, os.kill, [min(before), signal.SIGKILL])
    timer.start()
    with caplog.at_level(logging.WARNING, "mlsroad_pipeline"):
        store_at(tmp_path / "there", n_workers=2).save(tasks(marks, 8, pause=0.5))
    timer.join()
    assert any("another one is started" in message for message in caplog.messages)
    assert len(workers() & before) == 1
    here = {name: digest for name, digest in tree_digest(tmp_path / "here").items() if "json" not in name}
    assert {name: digest for name, digest in tree_digest(tmp_path / "there").items() if "json" not in name} == here


def test_workers_killed_between_stages_are_replaced(tmp_path, marks):
    for number in workers():
        os.kill(number, signal.SIGKILL)
    store_at(tmp_path / "stage", n_workers=2).save(tasks(marks))
    assert count_marks(marks) == 4


def test_a_stage_that_is_left_early_ends_the_cluster(tmp_path):
    store = store_at(tmp_path / "s")._store
    from mlsroad_pipeline.execution.worker import SceneJob

    token, running = store.begin(), workers()
    parameters = [{"n": 5, "seed": i, "pause": 20.0 * (i > 0)} for i in range(3)]
    jobs = [
        SceneJob(f"s{i}", SceneTask(make_points, {}, given), "f", store, token, "dask")
        for i, given in enumerate(parameters)
    ]
    scenes = run_on_cluster(jobs, Execution("dask", n_workers=2))
    assert next(scenes).key == "s0"
    scenes.close()
    assert not local_cluster._clusters and not any(map(psutil.pid_exists, running))


RUN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from multiprocessing import forkserver
from helpers.store import slow_parts
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution import fork_server
from mlsroad_pipeline.execution.task import SceneTask
root, marks, how, pause = sys.argv[1:]
if how == "forked":
    fork_server.start("mlsroad_pipeline.execution.dask_worker")
store = SceneStoreDataset(filepath=root, execution={"backend": "dask", "n_workers": 2})
print(forkserver._forkserver._forkserver_pid, flush=True)
store.save({f"s{i}": SceneTask(slow_parts, {}, {"seed": i, "marks": marks, "pause": float(pause)}) for i in range(12)})
"""


@pytest.fixture
def temporary():
    """Return a folder for temporary files with a short path, as sockets need one."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def started(root, marks, temporary, how, pause):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "TMPDIR": str(temporary)}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", RUN, str(root), str(marks), how, str(pause)]
    return subprocess.Popen(command, env=environment, **streams)


def wait_for_records(root, n_records):
    deadline = time.monotonic() + 60
    while len(list(root.glob("*/record.json"))) < n_records:
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("how", ["forked", "interpreters"])
@pytest.mark.parametrize("end", [None, signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_of_a_driver_that_ends_is_interrupted_or_killed(tmp_path, marks, temporary, how, end):
    with started(tmp_path / "stage", marks, temporary, how, 0.3) as process:
        wait_for_records(tmp_path / "stage", 2)
        below = psutil.Process(process.pid).children(recursive=True)
        assert len(below) >= 3
        if end is not None:
            process.send_signal(end)
        assert process.wait(60) == (0 if end is None else -end)
        said = process.stderr.read()
    assert psutil.wait_procs(below, timeout=20)[1] == []
    if end == signal.SIGKILL:  # the next run removes the folder of the killed one
        (folder,) = temporary.iterdir()
        assert folder.name.startswith("mlsroad-")
    else:
        assert not list(temporary.iterdir()), said
    assert not [path for path in temporary.rglob("*") if path.suffix in (".pem", ".crt")]
    if end is None:
        assert said == "" or "scenes" in said
    store_at(tmp_path / "stage", n_workers=2, backend="sequential").save(tasks(marks, 12, pause=0.3))
    assert len(list((tmp_path / "stage").glob("*/record.json"))) == 12


def test_the_end_of_the_server_of_the_workers_is_survived(tmp_path, marks, temporary):
    with started(tmp_path / "stage", marks, temporary, "forked", 0.3) as process:
        server = int(process.stdout.readline())
        wait_for_records(tmp_path / "stage", 1)
        below = psutil.Process(process.pid).children(recursive=True)
        os.kill(server, signal.SIGKILL)
        assert process.wait(60) == 0, process.stderr.read()
    assert psutil.wait_procs(below, timeout=20)[1] == []
    assert len(list((tmp_path / "stage").glob("*/record.json"))) == 12
