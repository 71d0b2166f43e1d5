"""Speed, memory and error of ground removal, compared with the cloth simulation filter (CSF); speed of related steps.

    python benchmarks/bench_ground.py [--clouds street_1M street_20M] [--repeats 5] [--threads 1]

`$MLSROAD_RIVALS` holds the clouds (`<name>.npz` with `xyz`, `t` and `cls`, classes 1 to 4 being ground) and a Python
with CSF (`venv/bin/python`). Runs of the two filters alternate, medians are printed, compilation is not timed. CSF
reads float64, as its interface asks, prepared outside the time.
"""

import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _common import RIVALS, Timed, added_kib, cloud_arrays, found_program, parser, race, show
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.ground.upward_growing import classify_ground
from mlsroad_pipeline.algorithms.metrics.ground import score_ground
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk

GROUND_CLASSES = (1, 4)

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


def run_csf(python: Path, cloud: Path, threads: int) -> Timed:
    """Run CSF in its own process; the result is its added KiB and its labels."""
    with tempfile.TemporaryDirectory() as folder:
        labels = Path(folder) / "labels.npy"
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
        command = [python, "-c", CSF_RUN, cloud, labels]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        seconds, added = done.stdout.split()[-2:]
        return Timed(float(seconds), float("nan"), (int(added), np.load(labels)))


def race_ground(name: str, python: Path | None, repeats: int, threads: int) -> None:
    """Race the two filters on a cloud."""
    data = cloud_arrays(name)
    xyz, low, high = data["xyz"], *GROUND_CLASSES
    truth = (data["cls"] >= low) & (data["cls"] <= high)
    classify_ground(xyz[:1000], n_threads=threads)
    added = added_kib(lambda: classify_ground(xyz, n_threads=threads))
    works: dict[str, Callable[[], object]] = {"mlsroad": lambda: classify_ground(xyz, n_threads=threads)}
    if python is not None:
        works["CSF"] = lambda: run_csf(python, RIVALS / f"{name}.npz", threads)
    for program, timed in race(works, repeats=repeats).items():
        extra, labels = (added, timed.result) if program == "mlsroad" else timed.result
        found = score_ground(labels, truth)
        errors = {key: round(getattr(found, key), 4) for key in ("type_1", "type_2", "total", "kappa")}
        memory = {"bytes_per_point": round(extra * 1024 / len(xyz), 1)}
        show("ground", len(xyz), {program: timed}, threads=threads, **memory, **errors)


def race_outliers(xyz: np.ndarray, repeats: int, threads: tuple[int, ...] = (1, 2)) -> None:
    """Race the statistical outlier filter and the same rule with SciPy's tree, with 20 neighbours."""
    points = xyz.astype(np.float64) - xyz.min(axis=0)

    def with_scipy() -> np.ndarray:
        tree = cKDTree(points)
        parts = np.array_split(points, max(1, len(points) // 100_000))
        spacing = np.concatenate([tree.query(part, k=20)[0].mean(axis=1) for part in parts])
        positive = spacing[spacing > 0]
        return spacing <= spacing.mean() + 2 * np.sqrt(((positive - spacing.mean()) ** 2).sum() / (len(points) - 1))

    works: dict[str, Callable[[], np.ndarray]] = {
        f"mlsroad, {n} thread{'s' if n > 1 else ''}": lambda n=n: keep_inliers(points, n_threads=n) for n in threads
    }
    works["SciPy cKDTree, 1 thread"] = with_scipy
    keep_inliers(points[:1000])
    for program, timed in race(works, repeats=repeats).items():
        show("statistical outliers", len(points), {program: timed}, outliers=int((~timed.result).sum()))


def time_companions(name: str, repeats: int) -> None:
    """Time steps that no competing program offers."""
    data = cloud_arrays(name)
    xyz, chunk = data["xyz"], PointCloud(data["xyz"][:2_000_000], {"gps_time": data["t"][:2_000_000]})
    is_ground = classify_ground(xyz)
    mixed = xyz[np.random.default_rng(0).permutation(len(xyz))]  # the filter's worst case: no neighbours in order
    works: dict[str, tuple[Callable[[], object], int]] = {
        "ground, shuffled points": (lambda: classify_ground(mixed), len(xyz)),
        "height_above_ground": (lambda: height_above_ground(xyz, is_ground), len(xyz)),
        "inspect_chunk": (lambda: inspect_chunk(chunk), len(chunk)),
    }
    for kernel, (work, n_points) in works.items():
        show(kernel, n_points, race({"mlsroad": work}, repeats=repeats, warm_up=1))
    race_outliers(xyz[:2_000_000], min(repeats, 3))


def main() -> None:
    """Run all races."""
    arguments = parser(__doc__)
    arguments.add_argument("--clouds", nargs="+", default=["street_1M", "street_20M"])
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--threads", type=int, default=1)
    options = arguments.parse_args()
    python = found_program("venv", "bin", "python", module="CSF")
    for name in options.clouds:
        race_ground(name, python, options.repeats, options.threads)
        time_companions(name, options.repeats)


if __name__ == "__main__":
    main()
