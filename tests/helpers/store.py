"""Functions for the tests of the scene store; they live in a module that worker processes can import."""

from __future__ import annotations

import hashlib
import os
import signal
import time
import uuid
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution.task import SceneTask


def mark(folder, name):
    """Leave a file behind: how often a function ran is then known whatever process it ran in."""
    Path(folder, f"{name}.{uuid.uuid4().hex}").touch()


def count_marks(folder, name=""):
    return len(list(Path(folder).glob(f"{name}*")))


def make_cloud(n, seed=0, source="survey.laz"):
    rng = np.random.default_rng(seed)
    columns = {
        "rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8),
        "intensity": rng.random(n, dtype=np.float32),
        "gps_time": 3e5 + np.cumsum(rng.random(n)),
        "label": rng.integers(-1, 9, n).astype(np.int16),
        "normals": rng.normal(size=(n, 3)),
    }
    return PointCloud(rng.normal(size=(n, 3)), columns, np.array([5e5 + 0.1, 4.5e6 + 0.2, 1 / 3]), "WKT", source)


def make_points(*, n, seed, marks=None, pause=0.0):
    if marks is not None:
        mark(marks, f"points-{seed}")
    time.sleep(pause)
    return make_cloud(n, seed)


def slow_parts(*, seed, marks, pause):
    """Return several parts, big enough for a kill to hit the writing of them."""
    cloud = make_cloud(20_000, seed)
    time.sleep(pause)
    mark(marks, f"s{seed}")
    return {"points": cloud, "features": {"xyz": cloud.xyz, "square": cloud.xyz**2}}


def square(*, cloud, exponent=2, marks=None):
    if marks is not None:
        mark(marks, "square")
    return {"values": cloud.xyz**exponent}


def sum_up(*, parts, factor):
    return {"total": np.array([factor * sum(p["values"].sum() for p in parts)])}


def read_text(*, path, marks=None):
    if marks is not None:
        mark(marks, "read")
    text = Path(path).read_bytes()
    if text == b"bad":
        raise DataError(f"{path}: bad text")
    return {"length": np.array([len(text)])}


def fail_on(*, cloud):
    raise ZeroDivisionError(f"no {len(cloud)}")


def refuse_negative(result):
    if (result["values"] < 0).any():
        raise DataError("values must not be negative")


def give(*, value):
    return value


def inner_threads():
    import numba
    from threadpoolctl import threadpool_info

    blas = [pool["num_threads"] for pool in threadpool_info()]
    return {"numba": np.array([numba.get_num_threads()]), "pools": np.array(blas, dtype=np.int64)}


def see_shared(*, model, store):
    files = list(Path(store, ".shared").glob("*.pickle"))
    return {"sum": np.array([model.sum()]), "files": np.array([len(files)])}


def die(*, marks, name, always):
    """Kill this process the first time, or always; the driver itself must never be the one that dies."""
    first = count_marks(marks, name) == 0
    mark(marks, name)
    if always or first:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"done": np.ones(1)}


def interrupt():
    raise KeyboardInterrupt


def tree_digest(folder):
    """Digest of every file below a folder by its relative path."""
    root = Path(folder)
    files = sorted(p for p in root.rglob("*") if p.is_file())
    return {p.relative_to(root).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


HERE = {"backend": "sequential", "progress": False}


def store_at(path, **kwargs):
    return SceneStoreDataset(filepath=str(path), **{"execution": HERE, **kwargs})


def point_tasks(marks, n_scenes=3, n=50):
    return {f"s{i}": SceneTask(make_points, {}, {"n": n, "seed": i, "marks": str(marks)}) for i in range(n_scenes)}
