"""Speed of Euclidean clustering, trajectory coordinates and inventory, compared with other tools.

``$MLSROAD_RIVALS`` is a folder with PCL's programs in ``build/`` and clouds ``street_{1M,5M,20M}_off.npz``; SciPy is
that of this environment. Runs of the tools alternate, medians are printed, and compilation is not timed. One JSON line
per figure follows the table.

    MLSROAD_RIVALS=rivals_data python benchmarks/bench_clusters.py [1M 5M ...]
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.objects.extraction import extract_objects
from mlsroad_pipeline.algorithms.inventory.objects.merging import merge_across_scenes
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

TOLERANCE = 0.15
REPEATS = 3
SCIPY_UP_TO = 1_000_000  # points: beyond it the pairs fill the memory
PCL_UP_TO = 3_000_000  # points: beyond it a run takes minutes


def timed(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def race(runs: dict[str, Callable[[], float]]) -> dict[str, float]:
    """Run the tools alternately, REPEATS times; return the median seconds of each."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(REPEATS):
        for name, run in runs.items():
            times[name].append(run())
    return {name: median(values) for name, values in times.items()}


def scipy_components(xyz: np.ndarray) -> np.ndarray:
    pairs = cKDTree(xyz).query_pairs(TOLERANCE, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(xyz), len(xyz)))
    return connected_components(graph, directed=False)[1]


def pcl_seconds(program: Path, cloud: Path) -> float:
    command = [program, "--kernel", "cluster", "--pcd", cloud, "--tol", str(TOLERANCE), "--repeats", "1"]
    line = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip().splitlines()[-1]
    return float(json.loads(line)["median_s"])


def cluster_race(rivals: Path, size: str) -> list[dict[str, object]]:
    xyz = np.load(rivals / f"street_{size}_off.npz")["xyz"]
    runs: dict[str, Callable[[], float]] = {"mlsroad": lambda: timed(lambda: cluster(xyz, tolerance=TOLERANCE))}
    cloud = rivals / f"street_{size}_off.pcd"
    for name, file in (("PCL", "bench_pcl"), ("PCL, native build", "bench_pcl_native")):
        program = rivals / "build" / file
        if not program.exists():
            print(f"not found: {file}")
        elif len(xyz) <= PCL_UP_TO:
            runs[name] = partial(pcl_seconds, program, cloud)
    if len(xyz) <= SCIPY_UP_TO:
        runs["SciPy components"] = lambda: timed(lambda: scipy_components(xyz))
    return [
        {"kernel": f"clusters {TOLERANCE} m", "points": len(xyz), "program": name, "seconds": round(seconds, 4)}
        for name, seconds in race(runs).items()
    ]


def locate_race(n_points: int = 1_000_000) -> list[dict[str, object]]:
    rng = np.random.default_rng(0)
    s = np.linspace(0, 2000, 20_001)
    path = Trajectory.from_positions(np.column_stack([s, 60 * np.sin(s / 150), 0 * s]))
    along = np.sort(rng.uniform(0, 2000, n_points))
    xyz = np.column_stack([along, 60 * np.sin(along / 150) + rng.uniform(-20, 20, n_points), 0 * along])
    tree = cKDTree(path.xyz[:, :2])
    runs = {
        "mlsroad": lambda: timed(lambda: path.locate(xyz)),
        "SciPy cKDTree, nearest vertex only": lambda: timed(lambda: tree.query(xyz[:, :2])),
    }
    return [
        {"kernel": "station and offset", "points": n_points, "program": name, "seconds": round(seconds, 4)}
        for name, seconds in race(runs).items()
    ]


def inventory_race(rivals: Path, size: str) -> list[dict[str, object]]:
    cloud = np.load(rivals / f"street_{size}.npz")
    xyz, label = cloud["xyz"], cloud["cls"]
    kinds = {"pole": 6, "sign": 7, "vehicle": 8, "tree": 9}
    rules = {kind: ObjectRule.of_kind(kind, code) for kind, code in kinds.items()}
    sure = np.ones(len(xyz))

    def run() -> object:
        return merge_across_scenes([extract_objects(xyz, label, sure, classes=rules)], classes=rules)

    seconds = race({"mlsroad": lambda: timed(run)})["mlsroad"]
    return [{"kernel": "inventory", "points": len(xyz), "program": "mlsroad", "seconds": round(seconds, 4)}]


def main() -> None:
    """Run all races and print the table."""
    warm = np.random.default_rng(0).random((200, 3))
    for dtype in (np.float32, np.float64):
        cluster(warm.astype(dtype), tolerance=0.1)
    locate_race(1000)  # compiles
    rows = locate_race()
    rivals = Path(os.environ.get("MLSROAD_RIVALS", ""))
    for size in sys.argv[1:] or ["1M", "5M"]:
        if not (rivals / f"street_{size}_off.npz").is_file():
            print(f"not found: street_{size}_off.npz (set MLSROAD_RIVALS)")
            continue
        rows += cluster_race(rivals, size) + inventory_race(rivals, size)
    for row in rows:
        speed = row["points"] / row["seconds"] / 1e6
        print(
            f"{row['kernel']:<20} {row['points']:>10,} {row['program']:<36} {row['seconds']:>9.4f} s {speed:7.2f} M/s"
        )
    for row in rows:
        print(json.dumps(row))


if __name__ == "__main__":
    main()
