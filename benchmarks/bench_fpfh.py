"""Speed of FPFH and of patches, compared with Open3D and PCL.

    MLSROAD_RIVALS=rivals_data python benchmarks/bench_fpfh.py [--threads 1 2] [--repeats 3]

`$MLSROAD_RIVALS` holds PCL's programs in `build/` and clouds `street_1M.npz` and `street_1M_off.npz`; Open3D is that of
this environment. All get the same points. This package and Open3D get the same normals; PCL estimates its own from 30
neighbours, which is not timed. Runs alternate, medians are printed, compilation is not timed.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from _common import RIVALS, cloud_arrays, parser, pcl_programs, race, run_pcl, show, voxel_centroids

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.papers.shared.patches.extraction import extract_patches

RADIUS = 0.3
VOXEL = 0.05
RAW = 100_000


def write_pcd(path: Path, xyz: np.ndarray) -> None:
    n = len(xyz)
    header = f"VERSION 0.7\nFIELDS x y z rgba\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH {n}\nHEIGHT 1\n"
    header += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    table = np.zeros(n, dtype=[("xyz", "<f4", 3), ("rgba", "<u4")])
    table["xyz"] = xyz
    path.write_bytes(header.encode("ascii") + table.tobytes())


def fpfh_race(name: str, xyz: np.ndarray, threads: int, repeats: int) -> None:
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
    works: dict[str, Callable[[], object]] = {
        "mlsroad": lambda: compute_fpfh(xyz, normals, radius=RADIUS, n_threads=threads),
        "Open3D legacy": lambda: legacy(cloud, search),
        "Open3D tensor": lambda: of_tensor(tensor, max_nn=None, radius=RADIUS),
    }
    with tempfile.TemporaryDirectory() as folder:
        write_pcd(path := Path(folder) / "cloud.pcd", xyz)
        for entrant, program in pcl_programs().items():
            works[entrant] = partial(run_pcl, program, "fpfh", path, radius=RADIUS, threads=threads)
        show(f"FPFH {name}", len(xyz), race(works, repeats=repeats), threads=threads)
    ours = compute_fpfh(xyz, normals, radius=RADIUS)
    differs = (np.abs(ours * 600 - np.asarray(legacy(cloud, search).data).T) > 1e-3).any(axis=1)
    print(f"{name}: {differs.sum()} of {len(xyz)} histograms differ from Open3D's by more than 1e-3 of 600 (bin edges)")


def patches_race(repeats: int) -> None:
    given = cloud_arrays("street_1M")
    scene = PointCloud(given["xyz"], {"rgb": given["rgb"]})
    height = given["xyz"][:, 2] - given["xyz"][:, 2].min()
    extract_patches(scene.select(np.arange(5000)), height=height[:5000])  # compiles
    found = race({"mlsroad": lambda: extract_patches(scene, height=height)}, repeats=repeats)
    show("patches", len(scene), found, threads=1)


def measure(threads: int, repeats: int) -> None:
    """Run all races with the number of threads that the libraries of this process were started with."""
    off = cloud_arrays("street_1M_off")["xyz"]
    raw = off[np.sort(np.random.default_rng(5).choice(len(off), RAW, replace=False))]
    fpfh_race("of voxel centroids", voxel_centroids(off, VOXEL), threads, repeats)
    fpfh_race("of raw points", raw, threads, repeats)
    if threads == 1:
        patches_race(repeats)


def main() -> None:
    """Run the races in a process for each number of threads: libraries take it from the environment at start."""
    arguments = parser(__doc__)
    arguments.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    arguments.add_argument("--repeats", type=int, default=3)
    arguments.add_argument("--here", action="store_true", help="measure in this process")
    options = arguments.parse_args()
    if not (RIVALS / "street_1M_off.npz").is_file():
        print("not found: street_1M_off.npz (set MLSROAD_RIVALS)")
        return
    if options.here:
        measure(options.threads[0], options.repeats)
        return
    for threads in options.threads:
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(names, str(threads))}
        command = [sys.executable, __file__, "--here", "--threads", str(threads), "--repeats", str(options.repeats)]
        subprocess.run(command, env=environment, check=True)


if __name__ == "__main__":
    main()
