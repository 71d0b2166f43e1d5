"""Speed, memory and error of ground removal beside the cloth simulation filter (CSF), and speed of its companions.

    python benchmarks/bench_ground.py [--clouds street_1M street_20M] [--repeats 5] [--threads 1]

Clouds (`<name>.npz` with `xyz` and `cls`, classes 1 to 4 being ground) and the rival's interpreter (`venv/bin/python`
with CSF) are looked for in the folder that $MLSROAD_RIVALS names. Prints a table and one JSON line per result. Runs of
the two filters alternate, medians are quoted, and compilation stays outside the time. The rival reads float64, as its
interface asks, prepared outside the time.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.ground.upward_growing import classify_ground
from mlsroad_pipeline.algorithms.metrics.ground import score_ground
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk

LAST_GROUND_CLASS = 4

CSF_RUN = """
import sys, time
import numpy as np, CSF
def memory(field):
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith(field))
xyz = np.load(sys.argv[1])["xyz"].astype(np.float64)
open("/proc/self/clear_refs", "w").write("5")
before = memory("VmRSS")
start = time.perf_counter()
csf = CSF.CSF()
csf.params.bSloopSmooth = False
csf.params.cloth_resolution = 0.5
csf.params.rigidness = 3
csf.params.class_threshold = 0.15
csf.setPointCloud(xyz)
ground, rest = CSF.VecInt(), CSF.VecInt()
csf.do_filtering(ground, rest)
seconds = time.perf_counter() - start
after = memory("VmHWM")
is_ground = np.zeros(len(xyz), dtype=bool)
is_ground[np.array(ground)] = True
np.save(sys.argv[2], is_ground)
print(seconds, after - before)
"""


def added_kib(work: Callable[[], Any]) -> int:
    """Return by how much a call raised the resident memory of this process at its peak, KiB (Linux)."""

    def memory(field: str) -> int:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(field))

    ctypes.CDLL("libc.so.6").malloc_trim(0)  # freed memory that the process still holds would hide what the call takes
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # forgets the peak so far
    before = memory("VmRSS")
    work()
    return memory("VmHWM") - before


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return seconds and result."""
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def run_csf(python: Path, cloud: Path, threads: int) -> tuple[float, int, np.ndarray]:
    """Return the rival's seconds, added KiB and labels."""
    with tempfile.TemporaryDirectory() as folder:
        labels = Path(folder) / "labels.npy"
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
        command = [str(python), "-c", CSF_RUN, str(cloud), str(labels)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        seconds, added = done.stdout.split()[-2:]
        return float(seconds), int(added), np.load(labels)


def report(kernel: str, cloud: str, seconds: list[float], n_points: int, **more: Any) -> None:
    """Print one line of the table and its JSON."""
    median = statistics.median(seconds)
    row = {"kernel": kernel, "cloud": cloud, "points": n_points, "seconds": round(median, 4), **more}
    row["points_per_s"] = round(n_points / median)
    print(f"{kernel:24s} {cloud:12s} {median:8.3f} s {n_points / median / 1e6:8.2f} M/s  {more}")
    print(json.dumps(row))


def race_ground(path: Path, python: Path | None, repeats: int, threads: int) -> np.ndarray:
    """Race the two filters on a cloud and return this project's labels."""
    with np.load(path) as data:
        xyz, truth = data["xyz"], (data["cls"] >= 1) & (data["cls"] <= LAST_GROUND_CLASS)
    classify_ground(xyz[:1000], n_threads=threads)
    added = added_kib(lambda: classify_ground(xyz, n_threads=threads))
    ours: list[float] = []
    theirs: list[float] = []
    rival: tuple[float, int, np.ndarray] | None = None
    for _ in range(repeats):
        seconds, is_ground = timed(lambda: classify_ground(xyz, n_threads=threads))
        ours.append(seconds)
        if python is not None:
            rival = run_csf(python, path, threads)
            theirs.append(rival[0])
    for name, times, extra, labels in (
        ("mlsroad", ours, added, is_ground),
        *([("CSF", theirs, rival[1], rival[2])] if rival is not None else []),
    ):
        scores = score_ground(labels, truth)
        report(
            "ground",
            path.stem,
            times,
            len(xyz),
            program=name,
            threads=threads,
            bytes_per_point=round(extra * 1024 / len(xyz), 1),
            **{key: round(getattr(scores, key), 4) for key in ("type_1", "type_2", "total", "kappa")},
        )
    return is_ground


def main() -> None:
    """Run all races."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--clouds", nargs="+", default=["street_1M", "street_20M"])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    root = Path(os.environ.get("MLSROAD_RIVALS", "rivals_data"))
    python: Path | None = root / "venv" / "bin" / "python"
    if python is not None and not python.exists():
        print(f"rival not found: {python} (set MLSROAD_RIVALS)")
        python = None
    for name in arguments.clouds:
        path = root / f"{name}.npz"
        if not path.exists():
            sys.exit(f"cloud not found: {path} (set MLSROAD_RIVALS)")
        is_ground = race_ground(path, python, arguments.repeats, arguments.threads)
        time_companions(path, is_ground, arguments.repeats)


def race_outliers(xyz: np.ndarray, cloud: str, repeats: int, threads: tuple[int, ...] = (1, 2)) -> None:
    """Race the statistical outlier filter and the same rule with SciPy's tree, with 20 neighbours."""
    points = xyz.astype(np.float64) - xyz.min(axis=0)

    def with_scipy() -> np.ndarray:
        tree = cKDTree(points)
        parts = np.array_split(points, max(1, len(points) // 100_000))
        spacing = np.concatenate([tree.query(part, k=20)[0].mean(axis=1) for part in parts])
        positive = spacing[spacing > 0]
        return spacing <= spacing.mean() + 2 * np.sqrt(((positive - spacing.mean()) ** 2).sum() / (len(points) - 1))

    runs: dict[str, Callable[[], np.ndarray]] = {
        f"mlsroad, {n} thread{'s' if n > 1 else ''}": lambda n=n: keep_inliers(points, n_threads=n) for n in threads
    }
    runs["SciPy cKDTree, 1 thread"] = with_scipy
    keep_inliers(points[:1000])
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    kept = {}
    for _ in range(repeats):
        for name, run in runs.items():
            taken, kept[name] = timed(run)
            seconds[name].append(taken)
    for name, times in seconds.items():
        report("statistical outliers", cloud, times, len(points), program=name, outliers=int((~kept[name]).sum()))


def time_companions(path: Path, is_ground: np.ndarray, repeats: int) -> None:
    """Time what has no rival here."""
    with np.load(path) as data:
        xyz, times = data["xyz"], data["t"]
    chunk = PointCloud(xyz[:2_000_000], {"gps_time": times[:2_000_000]})
    mixed = xyz[np.random.default_rng(0).permutation(len(xyz))]  # the filter's worst case: no neighbours in order
    companions: dict[str, tuple[Callable[[], Any], int]] = {
        "ground, shuffled points": (lambda: classify_ground(mixed), len(xyz)),
        "height_above_ground": (lambda: height_above_ground(xyz, is_ground), len(xyz)),
        "inspect_chunk": (lambda: inspect_chunk(chunk), len(chunk)),
    }
    for kernel, (work, n_points) in companions.items():
        work()
        report(kernel, path.stem, [timed(work)[0] for _ in range(repeats)], n_points)
    race_outliers(xyz[:2_000_000], path.stem, min(repeats, 3))


if __name__ == "__main__":
    main()
