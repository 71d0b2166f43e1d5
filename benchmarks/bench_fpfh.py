"""Speed of FPFH and of patches, beside Open3D and PCL where they are found.

Rivals and clouds are those that ``$MLSROAD_RIVALS`` holds: PCL's programs in ``build/``, clouds
``street_1M.npz`` and ``street_1M_off.npz``; Open3D is that of this environment. All get the same points. This package
and Open3D get the same normals too; PCL estimates its own from 30 neighbours, outside the time. Runs alternate, medians
are printed, compilation is outside. One JSON line per figure is written to standard output after the table.

    MLSROAD_RIVALS=rivals_data python benchmarks/bench_fpfh.py [--threads 1 2] [--repeats 3]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.papers.shared.patches.extraction import extract_patches

RADIUS = 0.3
VOXEL = 0.05
RAW = 100_000


def timed(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def race(runs: dict[str, Callable[[], float]], repeats: int) -> dict[str, float]:
    """Run the entrants in turn; return each one's median seconds."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            times[name].append(run())
    return {name: median(values) for name, values in times.items()}


def voxel_centroids(xyz: np.ndarray) -> np.ndarray:
    cells = np.floor((xyz - xyz.min(axis=0)) / VOXEL).astype(np.int64)
    key = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    _, owner, counts = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(owner, xyz[:, axis].astype(np.float64)) for axis in range(3)]
    return (np.stack(sums, axis=1) / counts[:, None]).astype(np.float32)


def write_pcd(path: Path, xyz: np.ndarray) -> None:
    n = len(xyz)
    header = f"VERSION 0.7\nFIELDS x y z rgba\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH {n}\nHEIGHT 1\n"
    header += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    table = np.zeros(n, dtype=[("xyz", "<f4", 3), ("rgba", "<u4")])
    table["xyz"] = xyz
    path.write_bytes(header.encode("ascii") + table.tobytes())


def pcl_seconds(program: Path, cloud: Path, threads: int) -> float:
    command = [program, "--kernel", "fpfh", "--pcd", cloud, "--radius", str(RADIUS), "--repeats", "1"]
    command += ["--threads", str(threads)]
    line = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True).stdout
    return float(json.loads(line.strip().splitlines()[-1])["median_s"])


def fpfh_race(name: str, xyz: np.ndarray, rivals: Path, threads: int, repeats: int) -> list[dict[str, object]]:
    import open3d as o3d  # noqa: PLC0415  it reads the number of threads when it is loaded

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz.astype(np.float64)))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(30))
    cloud.orient_normals_to_align_with_direction([0.0, 0.0, 1.0])
    normals = np.asarray(cloud.normals).astype(np.float32)
    cloud.normals = o3d.utility.Vector3dVector(normals.astype(np.float64))
    tensor = o3d.t.geometry.PointCloud.from_legacy(cloud)
    search = o3d.geometry.KDTreeSearchParamRadius(RADIUS)
    legacy = o3d.pipelines.registration.compute_fpfh_feature
    of_tensor = o3d.t.pipelines.registration.compute_fpfh_feature
    compute_fpfh(xyz[:2000], normals[:2000], radius=RADIUS, n_threads=threads)  # compiles
    runs: dict[str, Callable[[], float]] = {
        "mlsroad": lambda: timed(lambda: compute_fpfh(xyz, normals, radius=RADIUS, n_threads=threads)),
        "Open3D legacy": lambda: timed(lambda: legacy(cloud, search)),
        "Open3D tensor": lambda: timed(lambda: of_tensor(tensor, max_nn=None, radius=RADIUS)),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.pcd"
        write_pcd(path, xyz)
        for entrant, file in (("PCL", "bench_pcl"), ("PCL, native build", "bench_pcl_native")):
            program = rivals / "build" / file
            if program.exists():
                runs[entrant] = partial(pcl_seconds, program, path, threads)
            else:
                print(f"not found: {file}")
        found = race(runs, repeats)
    ours = compute_fpfh(xyz, normals, radius=RADIUS)
    differs = (np.abs(ours * 600 - np.asarray(legacy(cloud, search).data).T) > 1e-3).any(axis=1)
    print(f"{name}: {differs.sum()} of {len(xyz)} histograms differ from Open3D's by more than 1e-3 of 600 (bin edges)")
    return [
        {"kernel": f"FPFH {name}", "points": len(xyz), "threads": threads, "program": p, "seconds": round(s, 4)}
        for p, s in found.items()
    ]


def patches_race(rivals: Path, repeats: int) -> list[dict[str, object]]:
    given = np.load(rivals / "street_1M.npz")
    scene = PointCloud(given["xyz"], {"rgb": given["rgb"]})
    height = given["xyz"][:, 2] - given["xyz"][:, 2].min()
    extract_patches(scene.select(np.arange(5000)), height=height[:5000])  # compiles
    seconds = race({"mlsroad": lambda: timed(lambda: extract_patches(scene, height=height))}, repeats)["mlsroad"]
    return [{"kernel": "patches", "points": len(scene), "threads": 1, "program": "mlsroad", "seconds": seconds}]


def measure(threads: int, repeats: int) -> None:
    """Run all races with a number of threads that the libraries of this process were started with."""
    rivals = Path(os.environ["MLSROAD_RIVALS"])
    off = np.load(rivals / "street_1M_off.npz")["xyz"]
    raw = off[np.sort(np.random.default_rng(5).choice(len(off), RAW, replace=False))]
    rows = fpfh_race("of voxel centroids", voxel_centroids(off), rivals, threads, repeats)
    rows += fpfh_race("of raw points", raw, rivals, threads, repeats)
    if threads == 1:
        rows += patches_race(rivals, repeats)
    for row in rows:
        print(
            f"{row['kernel']:<24} {row['points']:>9,} {row['threads']} thread(s) "
            f"{row['program']:<20} {row['seconds']:>8.3f} s"
        )
    for row in rows:
        print(json.dumps(row))


def main() -> None:
    """Run the races in a process for each number of threads: libraries take it from the environment at start."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--here", action="store_true", help="measure in this process")
    arguments = parser.parse_args()
    if not (Path(os.environ.get("MLSROAD_RIVALS", "")) / "street_1M_off.npz").is_file():
        print("not found: street_1M_off.npz (set MLSROAD_RIVALS)")
        return
    if arguments.here:
        measure(arguments.threads[0], arguments.repeats)
        return
    for threads in arguments.threads:
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(names, str(threads))}
        command = [sys.executable, __file__, "--here", "--threads", str(threads), "--repeats", str(arguments.repeats)]
        subprocess.run(command, env=environment, check=True)


if __name__ == "__main__":
    main()
