"""Speed, memory and error of ground removal, compared with the cloth simulation filter (CSF); speed of related steps.

    python benchmarks/bench_ground.py [--clouds street_1M street_20M] [--repeats 5] [--threads 1]
    python benchmarks/bench_ground.py --recordings [--repeats 3]                   # with Patchwork++ on rotating scans

`$MLSROAD_RIVALS` holds the clouds (`<name>.npz` with `xyz`, `t` and `cls`, classes 1 to 4 being ground) and a Python
with CSF (`venv/bin/python`). Runs of the two filters alternate, medians are printed, compilation is not timed. CSF
reads float64, as its interface asks, prepared outside the time.
"""

import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import DATA, RIVALS, Timed, added_kib, cloud_arrays, configured, found_program, parser, race, show
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.ground.upward_growing import classify_ground
from mlsroad_pipeline.algorithms.metrics.ground import score_ground
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk

GROUND_CLASSES = (1, 4)
GROUND = {"road", "lane_marking", "parking", "sidewalk", "curb", "trail", "grass", "other_ground"}
"""Classes of the taxonomy that are ground."""

RUN = """
import sys, time
import numpy as np
{module}
def memory(field):
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith(field))
with np.load(sys.argv[1]) as stored:
    cloud = dict(stored)
{before}
open("/proc/self/clear_refs", "w").write("5")
before = memory("VmRSS")
start, used = time.perf_counter(), time.process_time()
{work}
seconds, cpu = time.perf_counter() - start, time.process_time() - used
after = memory("VmHWM")
is_ground = np.zeros(len(cloud["xyz"]), dtype=bool)
is_ground[np.array(ground)] = True
np.save(sys.argv[2], is_ground)
print(seconds, cpu, after - before)
"""

CSF = RUN.format(
    module="import CSF",
    before="""
xyz = cloud["xyz"].astype(np.float64)
""",
    work="""
csf = CSF.CSF()
csf.params.bSloopSmooth = False
csf.params.cloth_resolution = 0.5
csf.params.rigidness = 3
csf.params.class_threshold = 0.15
csf.setPointCloud(xyz)
ground, rest = CSF.VecInt(), CSF.VecInt()
csf.do_filtering(ground, rest)
""",
)

PATCHWORK = RUN.format(
    module="import pypatchworkpp",
    before="""
points = np.column_stack([cloud["xyz"], cloud["intensity"]]).astype(np.float32)
""",
    work="""
parameters = pypatchworkpp.Parameters()
parameters.sensor_height, parameters.verbose = float(cloud["sensor_height"]), False
found = pypatchworkpp.patchworkpp(parameters)
found.estimateGround(points)
ground = found.getGroundIndices()
""",
)
"""Defaults of Patchwork++ (Lee et al. 2022), which was made for single scans of a rotating scanner."""

PROGRAMS = {"CSF": CSF, "Patchwork++": PATCHWORK}


def run_rival(python: Path, program: str, cloud: Path, threads: int) -> Timed:
    """Run a competing program in its own process; the result is its added KiB and its labels."""
    with tempfile.TemporaryDirectory() as folder:
        labels = Path(folder) / "labels.npy"
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
        command = [python, "-c", program, cloud, labels]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        seconds, cpu, added = done.stdout.split()[-3:]
        return Timed(float(seconds), float(cpu), (int(added), np.load(labels)))


class Recorded(NamedTuple):
    """Recorded points, the true ground of those that have a class, and the height of a rotating scanner."""

    name: str
    xyz: NDArray
    intensity: NDArray
    truth: NDArray[np.bool_]
    known: NDArray[np.bool_]
    sensor_height: float | None = None


def recordings() -> Iterator[Recorded]:
    """Yield full scans of SemanticKITTI and blocks of Oakland 3-D below $MLSROAD_DATA."""
    codings = configured("classes")["codings"]

    def truth(codes: NDArray, coding: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        names = codings[coding]
        ground = [code for code, name in names.items() if name in GROUND]
        unknown = [code for code, name in names.items() if name in ("unlabelled", "outlier")]
        return np.isin(codes, ground), ~np.isin(codes, unknown)

    scans = {DATA / "semantickitti/000000.bin": DATA / "semantickitti/000000.label"}
    more = DATA / "real/semantickitti_more/makeonebug"
    scans |= {path: more / "label" / f"{path.stem}.label" for path in sorted((more / "pcd").glob("*.bin"))}
    for path, labels in scans.items():
        if path.is_file():
            rows = np.fromfile(path, np.float32).reshape(-1, 4)
            marks = truth(np.fromfile(labels, np.uint32) & 0xFFFF, "semantickitti")
            yield Recorded(f"{path.parent.name} {path.stem}", rows[:, :3], rows[:, 3], *marks, sensor_height=1.73)
    for path in sorted((DATA / "oakland").glob("*.xyz_label_conf.gz")):
        rows = pd.read_csv(path, sep=r"\s+", header=None, comment="#").to_numpy(np.float64)
        yield Recorded(path.name.partition(".")[0], rows[:, :3], np.zeros(len(rows)), *truth(rows[:, 3], "oakland"))


def race_recordings(rivals: Mapping[str, Path], repeats: int, threads: int) -> None:
    """Race the filters on recordings, Patchwork++ on scans of a rotating scanner alone."""
    for kind in (np.float32, np.float64):
        classify_ground(np.zeros((10, 3), kind), n_threads=threads)  # loads the kernels
    totals: dict[tuple[str, str], NDArray] = {}
    for one in recordings():
        with tempfile.TemporaryDirectory() as folder:
            cloud = Path(folder) / "cloud.npz"
            np.savez(cloud, xyz=one.xyz, intensity=one.intensity, sensor_height=one.sensor_height or 0.0)
            works: dict[str, Callable[[], object]] = {"mlsroad": partial(classify_ground, one.xyz, n_threads=threads)}
            for name, python in rivals.items():
                if name == "CSF" or one.sensor_height:
                    works[name] = partial(run_rival, python, PROGRAMS[name], cloud, threads)
            for name, timed in race(works, repeats=repeats, warm_up=1).items():
                labels = timed.result if name == "mlsroad" else timed.result[1]
                found = score_ground(labels, one.truth, valid=one.known)
                errors = {key: round(getattr(found, key), 4) for key in ("type_1", "type_2", "total", "kappa")}
                show(f"ground, {one.name}", len(one.xyz), {name: timed}, threads=threads, **errors)
                key = ("rotating scanner" if one.sensor_height else "line scanners", name)
                totals.setdefault(key, np.zeros(6))
                totals[key] += [*_counts(labels, one.truth, one.known), timed.cpu, len(one.xyz)]
    for (kind, name), (lost, ground, taken, objects, cpu, points) in totals.items():
        print(
            f"{kind}, {name}: type I {lost / ground:.4f}, type II {taken / objects:.4f}, total "
            f"{(lost + taken) / (ground + objects):.4f}, processor time {cpu / points * 1e6:.2f} s per million points"
        )


def _counts(labels: NDArray, truth: NDArray, known: NDArray) -> list[int]:
    """Return the ground that is lost, the ground, the objects taken for ground, and the objects."""
    return [int((part & known).sum()) for part in (truth & ~labels, truth, ~truth & labels, ~truth)]


def race_ground(name: str, python: Path | None, repeats: int, threads: int) -> None:
    """Race the two filters on a cloud."""
    data = cloud_arrays(name)
    xyz, low, high = data["xyz"], *GROUND_CLASSES
    truth = (data["cls"] >= low) & (data["cls"] <= high)
    classify_ground(xyz[:1000], n_threads=threads)
    added = added_kib(lambda: classify_ground(xyz, n_threads=threads))
    works: dict[str, Callable[[], object]] = {"mlsroad": lambda: classify_ground(xyz, n_threads=threads)}
    if python is not None:
        works["CSF"] = lambda: run_rival(python, CSF, RIVALS / f"{name}.npz", threads)
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
    arguments.add_argument("--recordings", action="store_true", help="race on recordings in place of clouds")
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--threads", type=int, default=1)
    options = arguments.parse_args()
    python = found_program("venv", "bin", "python", module="CSF")
    if options.recordings:
        modules = {"CSF": "CSF", "Patchwork++": "pypatchworkpp"}
        found = {name: found_program("venv", "bin", "python", module=module) for name, module in modules.items()}
        race_recordings({name: path for name, path in found.items() if path}, options.repeats, options.threads)
        return
    for name in options.clouds:
        race_ground(name, python, options.repeats, options.threads)
        time_companions(name, options.repeats)


if __name__ == "__main__":
    main()
