"""Scene store with several workers: equal bytes, killed workers, killed runs, clusters."""

import json
import logging
import os
import random
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import psutil
import pytest
from helpers.store import (
    count_marks,
    die,
    inner_threads,
    interrupt,
    make_points,
    see_shared,
    slow_parts,
    square,
    tree_digest,
)
from kedro.io import DatasetError

from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution import backends
from mlsroad_pipeline.execution import progress as execution
from mlsroad_pipeline.execution.progress import start_progress
from mlsroad_pipeline.execution.task import SceneError, SceneTask
from mlsroad_pipeline.execution.worker import SharedLimit


def store_at(path, **settings):
    return SceneStoreDataset(filepath=str(path), execution={"progress": False, **settings})


def part_tasks(marks, n_scenes=6, pause=0.0):
    return {
        f"s{i}": SceneTask(slow_parts, {}, {"seed": i, "marks": str(marks), "pause": pause}) for i in range(n_scenes)
    }


@pytest.fixture
def marks(tmp_path):
    folder = tmp_path / "marks"
    folder.mkdir()
    return folder


@pytest.fixture(scope="module")
def cluster():
    """A Dask scheduler at a tcp:// address with two workers."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address="127.0.0.1:0") as running:
        yield running


def two_stages(root, marks, **settings):
    first, second = store_at(root / "first", **settings), store_at(root / "second", **settings)
    first.save(part_tasks(marks))
    clouds = first.load().part("points")
    second.save({key: SceneTask(square, {"cloud": handle}) for key, handle in clouds.items()})
    return tree_digest(root)


def test_same_bytes_whatever_the_backend_and_the_number_of_workers(tmp_path, marks, cluster):
    expected = two_stages(tmp_path / "one", marks, backend="sequential")
    assert len(expected) == 2 + 6 * 3 + 6 * 2
    ways = {
        "threads": {"backend": "threading", "n_workers": 4},
        "one": {"backend": "loky", "n_workers": 1},
        "two": {"backend": "loky", "n_workers": 2},
        "four": {"backend": "loky", "n_workers": 4},
        "tcp": {"backend": "dask", "scheduler": cluster.scheduler_address},
        "window": {"backend": "dask", "scheduler": cluster.scheduler_address, "n_workers": 1},
    }
    for name, settings in ways.items():
        assert two_stages(tmp_path / name, marks, **settings) == expected, name


def dying_tasks(marks, always):
    tasks = {f"s{i}": SceneTask(make_points, {}, {"n": 5, "seed": i, "pause": 0.05}) for i in range(5)}
    return tasks | {"s2x": SceneTask(die, {}, {"marks": str(marks), "name": "die", "always": always})}


def test_scene_whose_worker_was_killed_gets_a_second_chance_alone(tmp_path, marks):
    store = store_at(tmp_path / "stage", backend="loky", n_workers=2)
    store.save(dying_tasks(marks, always=False))
    assert store.exists()
    assert count_marks(marks) == 2


def test_scene_that_kills_its_worker_is_named_and_the_others_finish(tmp_path, marks):
    store = store_at(tmp_path / "stage", backend="loky", n_workers=2)
    with pytest.raises(DatasetError, match="scene 's2x': its worker process was killed") as caught:
        store.save(dying_tasks(marks, always=True))
    assert isinstance(caught.value.__cause__, SceneError)
    assert [failure.scene for failure in caught.value.__cause__.failures] == ["s2x"]
    assert len(list((tmp_path / "stage").glob("*/record.json"))) == 5
    tasks = dying_tasks(marks, always=True)
    tasks.pop("s2x")
    store.save(tasks)
    assert store.exists()


def test_the_end_of_the_server_of_the_workers_is_that_of_a_worker(tmp_path, marks, monkeypatch):
    whole, ended = backends._parallel, []

    def parallel(*args, **config):
        if not ended:
            ended.append(True)
            raise EOFError("unexpected EOF")  # as multiprocessing does when its server was killed
        yield from whole(*args, **config)

    monkeypatch.setattr(backends, "_parallel", parallel)
    store = store_at(tmp_path / "stage", backend="loky", n_workers=2)
    store.save(part_tasks(marks, 3))
    assert store.exists() and count_marks(marks) == 3 and ended


def test_scene_that_kills_dask_workers_is_named(tmp_path, marks, caplog):
    caplog.set_level(logging.CRITICAL)
    from distributed import Client, LocalCluster

    silent = {
        "silence_logs": logging.CRITICAL,
        "memory_limit": 0,
        "dashboard_address": "127.0.0.1:0",
        "threads_per_worker": 1,
    }
    with LocalCluster(n_workers=2, **silent) as cluster, Client(cluster, set_as_default=False) as client:
        client.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0))
        store = store_at(tmp_path / "stage", backend="dask", scheduler=cluster.scheduler_address)
        with pytest.raises(DatasetError, match="scene 's2x': KilledWorker"):
            store.save(dying_tasks(marks, always=True))


@pytest.mark.parametrize("settings", [{"backend": "loky", "n_workers": 2}, {"backend": "threading", "n_workers": 2}])
def test_workers_have_one_inner_thread(tmp_path, settings):
    import numba

    before = numba.get_num_threads()
    store = store_at(tmp_path / "stage", **settings)
    store.save({"s": SceneTask(inner_threads), "t": SceneTask(inner_threads)})
    for value in store.load().load_all().values():
        assert value["numba"].tolist() == [1]
        assert set(value["pools"].tolist()) == {1}
    assert numba.get_num_threads() == before


def test_dask_workers_have_one_inner_thread(tmp_path, cluster):
    store = store_at(tmp_path / "stage", backend="dask", scheduler=cluster.scheduler_address)
    store.save({"s": SceneTask(inner_threads)})
    assert store.load()["s"].load()["numba"].tolist() == [1]


def test_inner_threads_come_back_when_the_last_stage_leaves():
    from threadpoolctl import threadpool_info

    def now():
        return [pool["num_threads"] for pool in threadpool_info()]

    before, limit = now(), SharedLimit()
    with limit.hold():
        with limit.hold():
            assert set(now()) <= {1}
        assert set(now()) <= {1}
    assert now() == before


def test_two_stores_saved_at_the_same_time(tmp_path, marks):
    errors = []

    def save(name):
        try:
            store_at(tmp_path / name, backend="loky", n_workers=2).save(part_tasks(marks, 4, pause=0.05))
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=save, args=(name,)) for name in ("a", "b")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert tree_digest(tmp_path / "a") == tree_digest(tmp_path / "b")
    assert count_marks(marks) == 8


def test_interrupt_in_a_thread_pool_leaves_a_resumable_store(tmp_path, marks):
    store = store_at(tmp_path / "stage", backend="threading", n_workers=2)
    tasks = part_tasks(marks, 3)
    with pytest.raises(KeyboardInterrupt):
        store.save({**tasks, "z": SceneTask(interrupt)})
    assert not store.exists()
    store.save(tasks)
    assert store.exists()


@pytest.mark.parametrize("backend", ["loky", "dask"])
def test_large_common_parameter_is_written_once_and_gone_afterwards(tmp_path, marks, cluster, backend):
    settings = {"backend": backend, **({"scheduler": cluster.scheduler_address} if backend == "dask" else {})}
    model = np.random.default_rng(0).random(300_000)
    tasks = {f"s{i}": SceneTask(see_shared, {}, {"model": model, "store": str(tmp_path / "stage")}) for i in range(4)}
    store = store_at(tmp_path / "stage", **settings)
    store.save(tasks)
    for value in store.load().load_all().values():
        assert value["sum"][0] == model.sum()
        assert value["files"][0] == 1
    assert not (tmp_path / "stage" / ".shared").exists()
    once = store_at(tmp_path / "here", backend="sequential")
    once.save(tasks)
    assert once.load().load_all()["s1"]["files"][0] == 0  # in one process there is nothing to send


def test_log_tells_how_far_a_stage_is(caplog, monkeypatch):
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(execution, "LOG_INTERVAL", 0.0)
    progress = start_progress("stage", 3, shown=True)
    for _ in range(3):
        progress.step()
    progress.close()
    assert [m.split(",")[0] for m in caplog.messages] == ["stage: 1 of 3 scenes", "stage: 2 of 3 scenes"]
    assert "s left" in caplog.messages[0]


def test_terminal_gets_a_bar_with_the_time_left(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    progress = start_progress("stage", 3, shown=True)
    time.sleep(0.15)
    progress.step()
    progress.close()
    text = capsys.readouterr().err
    assert "stage:" in text
    assert "1/3" in text


RUN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets what it runs in the background ignore it
from helpers.store import slow_parts
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution.task import SceneTask
root, marks, workers = sys.argv[1], sys.argv[2], int(sys.argv[3])
parameters = {"marks": marks, "pause": float(sys.argv[4])}
store = SceneStoreDataset(filepath=root, execution={"backend": "loky", "n_workers": workers})
print("start", flush=True)
store.save({f"s{i}": SceneTask(slow_parts, {}, {"seed": i, **parameters}) for i in range(16)})
"""


def start_run(root, marks, pause=0.02, **kwargs):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", RUN, str(root), str(marks), "2", str(pause)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment, **kwargs)


def whole_records(root, storage):
    found = {path.parent.name for path in root.glob("*/record.json")}
    return {
        key for key in found if (record := storage.read_record(key)) and storage.is_intact(key, record, checksums=True)
    }


def test_interrupt_ends_processes_at_once_and_leaves_a_resumable_store(tmp_path, marks):
    with start_run(tmp_path / "stage", marks, pause=0.2) as process:
        wait_for_records(tmp_path / "stage", 2)
        workers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == -signal.SIGINT
    assert psutil.wait_procs(workers, timeout=20)[1] == []
    root = tmp_path / "stage"
    assert json.loads((root / "manifest.json").read_text())["run"] is None
    store = store_at(root, backend="sequential")
    finished = whole_records(root, store._store)
    before = {key: count_marks(marks, f"{key}.") for key in finished}
    store.save(part_tasks(marks, 16, pause=0.2))
    assert store.exists()
    assert {key: count_marks(marks, f"{key}.") for key in finished} == before
    assert not list(root.rglob("*.tmp"))  # interrupted workers may leave some, and the next run removes them


def wait_for_records(root, n_records):
    deadline = time.monotonic() + 30
    while len(list(root.glob("*/record.json"))) < n_records:
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.mark.parametrize("group", [False, True], ids=["driver", "driver_and_workers"])
def test_run_killed_at_random_moments_ends_with_the_same_bytes(tmp_path, marks, group):
    """Kill -9 twice: the driver only, so that its workers outlive it briefly, or all processes."""
    undisturbed = tmp_path / "undisturbed"
    store_at(undisturbed, backend="sequential").save(
        {f"s{i}": SceneTask(slow_parts, {}, {"seed": i, "marks": str(marks), "pause": 0.02}) for i in range(16)}
    )
    root, moments = tmp_path / "stage", random.Random(20160217 + group)
    storage = store_at(root)._store
    for _ in range(2):
        finished = whole_records(root, storage)
        before = {key: count_marks(marks, f"{key}.") for key in finished}
        with start_run(root, marks, start_new_session=True) as process:
            assert process.stdout.readline() == b"start\n"
            wait_for_records(root, len(finished) + moments.randint(0, 3))
            time.sleep(moments.uniform(0.0, 0.04))
            processes = psutil.Process(process.pid).children(recursive=True)
            (os.killpg if group else os.kill)(process.pid, signal.SIGKILL)
        assert psutil.wait_procs(processes, timeout=20)[1] == []
        for key in whole_records(root, storage):
            assert tree_digest(root / key) == tree_digest(undisturbed / key)
        assert {key: count_marks(marks, f"{key}.") for key in finished} == before
    finished = whole_records(root, storage)
    before = {key: count_marks(marks, f"{key}.") for key in finished}
    with start_run(root, marks) as process:
        assert process.wait(60) == 0, process.stderr.read()
    assert {key: count_marks(marks, f"{key}.") for key in finished} == before
    assert tree_digest(root) == tree_digest(undisturbed)
