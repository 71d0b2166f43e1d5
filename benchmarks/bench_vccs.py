"""Supervoxels beside PCL's: speed on one and two threads, number, boundary recall, under-segmentation, ceiling.

    MLSROAD_RIVALS=FOLDER python benchmarks/bench_vccs.py [--cloud street_5M_off] [--repeats 5] [--no-quality]

The folder holds `build/bench_pcl` and `build/bench_pcl_native` (PCL as it is shipped, and compiled for this processor)
and the clouds `<cloud>.npz` (xyz, rgb, cls, instance) and `<cloud>.pcd`. A program that is not there is named and left
out.

Speed: the programs take turns, `--repeats` rounds, and the median is printed; compilation and reading stay outside.
PCL's time covers construction, `extract`, `getSupervoxelAdjacency` and destruction, and leaves out `getLabeledCloud`;
ours covers everything that `segment_supervoxels` returns, the label of every point included. Both get the same points,
colours and weights and fit normals to the voxels. CPU time is printed as well, because it bears other load better.

Quality: PCL's labels come from its `--dump`; the reference is the scene's class and instance of every point; near pairs
are the ten nearest neighbours of 200,000 points. Points that PCL leaves without a label form one segment of theirs.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.metrics.partition import evaluate_partition
from mlsroad_pipeline.algorithms.supervoxels.vccs import Supervoxels, segment_supervoxels

SETTINGS = [(0.05, 0.1), (0.2, 0.6)]
RIVALS = ["bench_pcl", "bench_pcl_native"]


def run_rival(program: Path, cloud: Path, size: float, seed: float, dump: Path | None = None) -> dict:
    """Run PCL once and return its report."""
    command = [program, "--kernel", "vccs", "--pcd", cloud, "--voxel", size, "--seed", seed, "--repeats", 1]
    command += ["--threads", 1] + (["--dump", dump] if dump else [])
    out = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=True).stdout
    return json.loads(out.splitlines()[-1])


def run_ours(data: dict, size: float, seed: float, coloured: bool, n_threads: int) -> tuple[float, float, Supervoxels]:
    """Run this project's supervoxels once; return wall time, CPU time and the result."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = segment_supervoxels(
        data["xyz"],
        rgb=data["rgb"] if coloured else None,
        voxel_size=size,
        seed_resolution=seed,
        n_threads=n_threads,
    )
    return time.perf_counter() - wall, time.process_time() - cpu, result


def race(data: dict, rivals: dict[str, Path], cloud: Path, size: float, seed: float, repeats: int) -> list[dict]:
    """Let all contestants take turns and return a row for each."""
    ours = {
        f"mlsroad{' rgb' if coloured else ''}, {n} thread{'s' if n > 1 else ''}": (coloured, n)
        for coloured in (False, True)
        for n in (1, 2)
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in [*rivals, *ours]}
    counts: dict[str, int] = {}
    for _ in range(repeats):
        for name, program in rivals.items():
            report = run_rival(program, cloud, size, seed)
            times[name].append((report["median_s"], report["cpu_s"]))
            counts[name] = report["supervoxels"]
        for name, (coloured, n_threads) in ours.items():
            wall, cpu, result = run_ours(data, size, seed, coloured, n_threads)
            times[name].append((wall, cpu))
            counts[name] = len(result) - result.n_islands
    rows = [
        {
            "kernel": f"VCCS {size:g} / {seed:g} m",
            "points": len(data["xyz"]),
            "program": name,
            "seconds": round(statistics.median(w for w, _ in t), 4),
            "median_cpu_s": round(statistics.median(c for _, c in t), 4),
            "supervoxels": counts[name],
        }
        for name, t in times.items()
    ]
    fastest = min((r["seconds"] for r in rows if r["program"] in rivals), default=None)
    for row in rows:
        row["times_fastest_rival"] = round(fastest / row["seconds"], 2) if fastest else None
    return rows


def judge(data: dict, rivals: dict[str, Path], cloud: Path, size: float, seed: float) -> list[dict]:
    """Score the partitions of one rival and of ours, with and without colour."""
    partitions = {
        f"mlsroad{' rgb' if coloured else ''}": run_ours(data, size, seed, coloured, 1)[2].labels
        for coloured in (False, True)
    }
    if rivals:
        with tempfile.TemporaryDirectory() as folder:
            dump = Path(folder) / "labels"
            name = next(reversed(rivals))
            run_rival(rivals[name], cloud, size, seed, dump)
            partitions[name] = np.fromfile(dump, np.uint32).astype(np.int64)
    chosen = np.random.default_rng(0).permutation(len(data["xyz"]))[:200_000]
    near = cKDTree(data["xyz"]).query(data["xyz"][chosen], k=11)[1][:, 1:]
    pairs = np.stack([np.repeat(chosen, 10), near.ravel()], axis=1)
    references = {"class": data["cls"].astype(int), "object": data["instance"].astype(int) * 16 + data["cls"]}
    rows = []
    for reference, truth in references.items():
        for name, labels in partitions.items():
            quality = evaluate_partition(labels, truth, pairs=pairs)
            rows.append(
                {
                    "voxel": size,
                    "seed": seed,
                    "reference": reference,
                    "contestant": name,
                    "segments": quality.n_segments,
                    "boundary_recall": round(quality.boundary_recall, 4),
                    "under_segmentation": round(quality.under_segmentation_error, 5),
                    "ceiling": round(quality.accuracy_ceiling, 5),
                }
            )
    return rows


def show(rows: list[dict]) -> None:
    """Print rows as a table, then as JSON lines."""
    widths = {key: max(len(key), *(len(str(row[key])) for row in rows)) for key in rows[0]}
    print("  ".join(key.ljust(width) for key, width in widths.items()))
    for row in rows:
        print("  ".join(str(row[key]).ljust(width) for key, width in widths.items()))
    for row in rows:
        print(json.dumps(row))


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cloud", default="street_5M_off")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--no-quality", action="store_true")
    arguments = parser.parse_args()
    folder = Path(os.environ.get("MLSROAD_RIVALS", "rivals_data"))
    path = folder / f"{arguments.cloud}.npz"
    if not path.exists():
        sys.exit(f"no cloud at {path}: set MLSROAD_RIVALS")
    with np.load(path) as archive:
        data = {key: archive[key] for key in ("xyz", "rgb", "cls", "instance")}
    rivals = {name: folder / "build" / name for name in RIVALS if (folder / "build" / name).exists()}
    for name in RIVALS:
        if name not in rivals:
            print(f"not found, left out: {folder / 'build' / name}")
    cloud = path.with_suffix(".pcd")
    for size, seed in SETTINGS:  # compile outside of the race
        for coloured in (False, True):
            run_ours({k: v[:1000] for k, v in data.items()}, size, seed, coloured, 2)
    for size, seed in SETTINGS:
        show(race(data, rivals, cloud, size, seed, arguments.repeats))
        if not arguments.no_quality:
            show(judge(data, rivals, cloud, size, seed))


if __name__ == "__main__":
    main()
