"""Costs of the scene store per scene, per point and per resumed run, compared with Kedro and plain files.

    python benchmarks/bench_store.py [--points 2000000] [--scenes 200] [--repeats 5]

Medians of alternating repetitions, without imports.
"""

from __future__ import annotations

import json
import logging
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from _common import parser, race
from kedro_datasets.pandas import ParquetDataset
from kedro_datasets.partitions import PartitionedDataset

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.datasets.scene_store_dataset import SceneStoreDataset
from mlsroad_pipeline.execution.result_files import ARRAYS, POINTS, read_part, write_part
from mlsroad_pipeline.execution.task import SceneTask

FOLDER = Path(tempfile.mkdtemp(prefix="mlsroad-bench-"))


def make_cloud(*, n: int, seed: int) -> PointCloud:
    """Return points with the columns of a coloured survey, at millimetre resolution."""
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.normal(0, 0.01, n))
    xyz = np.round(np.column_stack([along, rng.uniform(-15, 15, n), rng.exponential(2, n)]), 3)
    columns = {
        "rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8),
        "intensity": rng.integers(0, 256, n).astype(np.float32) / np.float32(255),
        "gps_time": 3e5 + np.arange(n) * 1e-6,
        "scanner": rng.integers(0, 2, n, dtype=np.uint8),
        "label": np.repeat(rng.integers(0, 40, n // 100 + 1), 100)[:n].astype(np.uint8),
    }
    return PointCloud(xyz.astype(np.float32), columns, np.array([5e5, 4.5e6, 100.0]))


def make_table(*, seed: int) -> pd.DataFrame:
    """Return a result at no cost, so that only the store is measured."""
    return pd.DataFrame({"seed": [seed]})


def report(what: str, way: str, value: float, unit: str) -> None:
    """Print one figure as a line of the table and as JSON."""
    print(f"{what:34s} {way:38s} {value:12.3f} {unit}")
    print(json.dumps({"benchmark": what, "way": way, "value": value, "unit": unit}))


def store_at(path: Path, backend: str, n_workers: int = 2, **settings: object) -> SceneStoreDataset:
    """Return a store without progress report."""
    execution = {"backend": backend, "n_workers": n_workers, "progress": False, **settings}
    return SceneStoreDataset(filepath=str(path), execution=execution)


def bench_scenes(n_scenes: int, repeats: int) -> None:
    """Measure the overhead of a scene with a table of one row as its result: computed, and resumed."""
    tasks = {f"s{i:05d}": SceneTask(make_table, parameters={"seed": i}) for i in range(n_scenes)}

    def computed(backend: str, n_workers: int) -> Callable[[], None]:
        def run() -> None:
            shutil.rmtree(FOLDER / "stage", ignore_errors=True)
            store_at(FOLDER / "stage", backend, n_workers).save(tasks)

        return run

    def partitioned() -> None:
        shutil.rmtree(FOLDER / "partitioned", ignore_errors=True)
        dataset = PartitionedDataset(
            path=str(FOLDER / "partitioned"), dataset=ParquetDataset, filename_suffix=".parquet"
        )
        dataset.save({key: lambda task=task: make_table(**task.parameters) for key, task in tasks.items()})

    ways = {
        "store, sequential": computed("sequential", 1),
        "store, loky, 2 workers": computed("loky", 2),
        "Kedro PartitionedDataset (no resume)": partitioned,
    }
    for name, timed in race(ways, repeats=repeats, warm_up=1).items():
        report("new scene", name, 1e3 * timed.seconds / n_scenes, "ms/scene")
    store = store_at(FOLDER / "stage", "loky")
    store.save(tasks)
    resumed = {"store, checksums": lambda: store.save(tasks)}
    for name, timed in race(resumed, repeats=repeats, warm_up=1).items():
        report("scene already valid", name, 1e3 * timed.seconds / n_scenes, "ms/scene")


def bench_formats(n_points: int, repeats: int) -> None:
    """Measure writing and reading one cloud, compared with the same columns in pandas and NumPy files."""
    cloud = make_cloud(n=n_points, seed=0)
    arrays = {"xyz": cloud.xyz, **cloud.columns}
    flat = {f"{name}{i}": a[:, i] for name, a in arrays.items() if a.ndim == 2 for i in range(a.shape[1])}
    frame = pd.DataFrame({**flat, **{name: a for name, a in arrays.items() if a.ndim == 1}})

    def write(kind: str, value: object, name: str) -> Callable[[], None]:
        def run() -> None:
            with open(FOLDER / name, "wb") as stream:
                write_part(kind, value, stream)

        return run

    paths = {n: str(FOLDER / n) for n in ("cloud.parquet", "arrays.npz", "pandas.parquet", "numpy.npz")}
    writers = {
        "cloud.parquet": write(POINTS, cloud, "cloud.parquet"),
        "arrays.npz": write(ARRAYS, arrays, "arrays.npz"),
        "pandas.parquet": lambda: frame.to_parquet(paths["pandas.parquet"], compression="zstd"),
        "numpy.npz": lambda: np.savez_compressed(paths["numpy.npz"], **arrays),
    }
    readers: dict[str, Callable[[], object]] = {
        "cloud.parquet": lambda: read_part(POINTS, paths["cloud.parquet"]),
        "arrays.npz": lambda: read_part(ARRAYS, paths["arrays.npz"]),
        "pandas.parquet": lambda: pd.read_parquet(paths["pandas.parquet"]),
        "numpy.npz": lambda: [np.load(paths["numpy.npz"])[name] for name in arrays],
    }
    for what, ways in [("write", writers), ("read", readers)]:
        for name, timed in race(ways, repeats=repeats, warm_up=1).items():
            report(f"{what} a cloud", name, n_points / timed.seconds / 1e6, "million points/s")
    for name, path in paths.items():
        report("size of a cloud", name, Path(path).stat().st_size / n_points, "bytes/point")


def main() -> None:
    """Run all benchmarks."""
    options = parser(__doc__)
    options.add_argument("--points", type=int, default=2_000_000)
    options.add_argument("--scenes", type=int, default=200)
    options.add_argument("--repeats", type=int, default=5)
    arguments = options.parse_args()
    logging.disable(logging.WARNING)
    try:
        bench_scenes(arguments.scenes, arguments.repeats)
        bench_formats(arguments.points, arguments.repeats)
    finally:
        shutil.rmtree(FOLDER)


if __name__ == "__main__":
    main()
