"""A missing scheduler, worker or folder of a Dask cluster ends with one line after a stated time."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
from distributed import Client
from helpers.store import make_points, tree_digest
from kedro.io import DatasetError

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.datasets import scene_store_dataset
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution import dask_cluster
from mlsroad_pipeline.execution.dask_cluster import _warn_of_open_ports
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.execution.worker import SceneJob, run_scene

TASKS = {f"s{i}": SceneTask(make_points, {}, {"n": 5, "seed": i, "pause": 0.3}) for i in range(8)}


def store_at(path, **settings):
    return SceneStoreDataset(filepath=str(path), execution={"progress": False, **settings})


def started(module, *arguments):
    command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
    places = os.pathsep.join(place for place in sys.path if place)
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": places}, **silent)


@pytest.fixture
def scheduler(tmp_path, unused_port):
    """A scheduler without workers: its process and its address."""
    address = f"tcp://127.0.0.1:{unused_port}"
    arguments = ["--host", "127.0.0.1", "--port", str(unused_port), "--no-dashboard", "--no-show"]
    process = started("dask_scheduler", *arguments)
    try:
        Client(address, timeout=30, set_as_default=False).close()
        yield process, address
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def unused_port():
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def reason(store, tasks=TASKS):
    """Return why a stage fails, in one line."""
    with pytest.raises((DatasetError, MlsRoadError)) as caught:
        store.save(tasks)
    error = caught.value if isinstance(caught.value, MlsRoadError) else caught.value.__cause__
    assert isinstance(error, MlsRoadError)
    return str(error)


def test_no_scheduler(tmp_path, unused_port, monkeypatch):
    monkeypatch.setattr(dask_cluster, "CONNECT_SECONDS", 1)
    address = f"tcp://127.0.0.1:{unused_port}"
    told = reason(store_at(tmp_path / "s", backend="dask", scheduler=address))
    assert told.startswith(f"no Dask scheduler answers at {address} within 1 s: start one with `dask scheduler`")


def test_no_worker_then_other_sources_then_a_lost_scheduler(tmp_path, scheduler, monkeypatch):
    process, address = scheduler
    store = store_at(tmp_path / "s", backend="dask", scheduler=address)
    with monkeypatch.context() as patch:
        patch.setattr(dask_cluster, "WORKER_SECONDS", 0.3)
        assert f"{address} has had no worker for 0.3 s: start some with `dask worker" in reason(store)
    worker = started("dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
    try:
        with monkeypatch.context() as patch:
            patch.setattr(scene_store_dataset, "installation", lambda: "sources 123456")
            told = reason(store, {"s0": TASKS["s0"]})
        assert "the worker on " in told and "this run sources 123456: install the same version" in told
        assert not list((tmp_path / "s").glob("*/record.json"))
        threading.Timer(1.0, process.send_signal, [signal.SIGKILL]).start()
        begin = time.monotonic()
        assert f"the Dask scheduler {address} was stopped or restarted" in reason(store)
        assert time.monotonic() - begin < 60
    finally:
        worker.kill()
        worker.wait()
    store_at(tmp_path / "s", backend="sequential").save(TASKS)
    assert store.exists()


@pytest.fixture
def cluster(scheduler):
    """Address of a scheduler with two workers, whose nannies replace them."""
    _, address = scheduler
    options = ("--nthreads", "1", "--nworkers", "2", "--no-dashboard", "--host", "127.0.0.1")
    workers = started("dask_worker", address, *options)
    try:
        yield address
    finally:
        for process in [*psutil.Process(workers.pid).children(recursive=True), workers]:
            process.kill()
        workers.wait()


def test_a_killed_worker_is_replaced_and_the_bytes_are_the_same(tmp_path, cluster):
    store_at(tmp_path / "here", backend="sequential").save(TASKS)
    with Client(cluster, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        killed = min(client.run(os.getpid).values())
        timer = threading.Timer(0.5, os.kill, [killed, signal.SIGKILL])
        timer.start()
        store_at(tmp_path / "there", backend="dask", scheduler=cluster).save(TASKS)
        timer.join()
        client.wait_for_workers(2, timeout=60)
        assert killed not in client.run(os.getpid).values()
    assert tree_digest(tmp_path / "there") == tree_digest(tmp_path / "here")


def test_label_on_a_cluster_writes_the_bytes_of_processes(tmp_path, cluster):
    def mlsroad(*words):
        command = [Path(sys.executable).with_name("mlsroad"), *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600)
        assert done.returncode == 0, done.stderr

    mlsroad("simulate", "--preset", "tiny", "--length", "20", "--params", "with_images=false")
    for name, options in {"here": ["backend=loky"], "there": ["backend=dask", f"scheduler={cluster}"]}.items():
        params = [word for option in options for word in ("--params", f"execution.{option}")]
        mlsroad("label", "street", "-o", name, *params)
    here, there = (tree_digest(tmp_path / name) for name in ("here", "there"))
    clouds = [name for name in here if name.endswith(".laz")]
    assert clouds and all(there[name] == here[name] for name in clouds)


def test_a_worker_without_the_folder_is_named(tmp_path):
    store = store_at(tmp_path / "s", backend="sequential")._store
    job = SceneJob("s0", TASKS["s0"], "f", store, store.begin(), "dask")
    shutil.rmtree(tmp_path / "s")
    cause = run_scene(job).failure.cause
    assert f"{store.url} is not there on " in cause and "this worker does not share that folder" in cause


def test_an_open_scheduler_is_warned_of_once(caplog):
    _warn_of_open_ports.cache_clear()
    for address in ("tcp://10.0.0.7:8786", "tcp://10.0.0.7:8786", "tls://10.0.0.7:8786", "tcp://127.0.0.1:8786"):
        _warn_of_open_ports(address)
    assert [message.split(":8786")[0] for message in caplog.messages] == ["tcp://10.0.0.7"]
