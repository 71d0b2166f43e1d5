"""Speed of neighbourhoods, features and the forest, beside jakteristics and scikit-learn.

    python benchmarks/bench_forest.py [--repeats 5]

Clouds and rivals are found through $MLSROAD_RIVALS; without them a random street is used and the
rival is named as missing. Calls alternate, medians are quoted, compilation is outside the time. Prints a table, and a
JSON line per row.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.features.eigen import EIGEN_FEATURES, compute_eigen_features
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features
from mlsroad_pipeline.algorithms.geometry.cell_grid import build_cell_grids
from mlsroad_pipeline.algorithms.geometry.neighbors import radius_neighbors
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labelling import nearest_supervoxels

RIVALS = Path(os.environ.get("MLSROAD_RIVALS", "rivals_data"))
RADIUS = 0.3

# Runs in the rivals' own environment: one call per line read, so that calls of the two sides can alternate.
JAKTERISTICS = """
import sys, time, warnings
import numpy as np, jakteristics
warnings.simplefilter("ignore")
xyz = np.load(sys.argv[1]).astype(np.float64)
for line in sys.stdin:
    start = time.perf_counter()
    jakteristics.compute_features(xyz, search_radius=float(sys.argv[2]), num_threads=int(line), max_k_neighbors=100000)
    print(time.perf_counter() - start, flush=True)
"""


def load(name: str) -> NDArray[np.float32]:
    """Load a benchmark cloud, or make a plane with posts where there is none."""
    path = RIVALS / f"{name}.npz"
    if path.exists():
        with np.load(path) as stored:
            return stored["xyz"]
    rng = np.random.default_rng(0)
    xyz = rng.random((500_000, 3)) * [60, 20, 0.02]
    xyz[::10, 2] = rng.random(50_000) * 6
    return xyz.astype(np.float32)


def centroids_of(xyz: NDArray[np.float32], size: float) -> NDArray[np.float32]:
    """Thin a cloud to the centroids of its voxels."""
    cells = np.floor((xyz - xyz.min(axis=0)) / size).astype(np.int64)
    _, owner, counts = np.unique(cells @ (1, 1 << 21, 1 << 42), return_inverse=True, return_counts=True)
    return np.stack([np.bincount(owner, column) for column in xyz.T.astype(float)], axis=1).astype(np.float32) / (
        counts[:, None].astype(np.float32)
    )


def partition(xyz: NDArray, size: float) -> tuple[NDArray[np.int32], csr_array]:
    """Put points in voxels joined by faces, edges and corners."""
    (grid,) = build_cell_grids(xyz, cell_size=size)
    owners = np.empty(len(xyz), np.int32)
    owners[grid.order] = np.repeat(np.arange(len(grid.keys)), np.diff(grid.starts))
    nx, ny, _ = grid.shape
    steps = [
        (z * ny + y) * nx + x for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1) if (x, y, z) != (0, 0, 0)
    ]
    pairs = []
    for step in steps:
        at = np.searchsorted(grid.keys, grid.keys + step).clip(max=len(grid.keys) - 1)
        near = np.flatnonzero(grid.keys[at] == grid.keys + step)
        pairs.append(np.stack([near, at[near]]))
    ends = np.hstack(pairs)
    return owners, csr_array((np.ones(ends.shape[1], np.int8), tuple(ends)), shape=(len(grid.keys),) * 2)


def clock(call: Callable[[], object]) -> float:
    """Time one call in seconds."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def race(ours: Callable[[], object], theirs: Callable[[], float] | None, repeats: int) -> tuple[float, float | None]:
    """Alternate the two sides and return their medians; the first call of each side warms up."""
    ours()
    if theirs is not None:
        theirs()
    mine, others = [], []
    for _ in range(repeats):
        mine.append(clock(ours))
        if theirs is not None:
            others.append(theirs())
    return median(mine), median(others) if others else None


def report(what: str, n: int, seconds: float, rival: str = "", rival_seconds: float | None = None) -> None:
    """Print a row of the table, and a line of JSON for each side."""
    ratio = "" if rival_seconds is None else f"{rival:>22s} {rival_seconds:8.3f} s  {rival_seconds / seconds:6.1f} x"
    print(f"{what:48s} {n:>9,d} {seconds:8.3f} s {1e6 * seconds / n:8.3f} us each {ratio}")
    for program, taken in (("mlsroad", seconds), (rival, rival_seconds)):
        if taken is not None:
            print(json.dumps({"kernel": what, "points": n, "program": program, "seconds": taken}), flush=True)


def race_jakteristics(repeats: int, scratch: Path) -> None:
    """Race all eigenvalue features against jakteristics' on voxel centroids."""
    xyz = centroids_of(load("street_1M_off"), 0.05)
    np.save(scratch, xyz)
    python = RIVALS / "venv/bin/python"
    for threads in (1, 2):
        rival = None
        process = None
        if python.exists():
            command = [str(python), "-c", JAKTERISTICS, str(scratch), str(RADIUS)]
            environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
            )

            def rival(process=process, threads=threads) -> float:
                process.stdin.write(f"{threads}\n")
                process.stdin.flush()
                return float(process.stdout.readline())
        else:
            print(f"rival not found: jakteristics ({python}; set MLSROAD_RIVALS)", file=sys.stderr)
        ours, theirs = race(
            lambda threads=threads: compute_eigen_features(xyz, radius=RADIUS, n_threads=threads), rival, repeats
        )
        report(
            f"{len(EIGEN_FEATURES)} eigenvalue features, 0.3 m, {threads} thread(s)",
            len(xyz),
            ours,
            "jakteristics",
            theirs,
        )
        if process is not None:
            process.communicate()
    report(
        "radius neighbours as CSR, 0.3 m",
        len(xyz),
        race(lambda: radius_neighbors(xyz, radius=RADIUS), None, repeats)[0],
    )


def race_scikit_learn(repeats: int, features: NDArray[np.float32], centroids: NDArray) -> None:
    """Race the flat forest against scikit-learn's with one job, on forests of two sizes."""
    rng = np.random.default_rng(0)
    height = centroids[:, 2] + rng.normal(0, 0.3, len(centroids))
    target = np.digitize(height, np.quantile(height, [0.2, 0.4, 0.6, 0.8])).astype(int)
    half = np.arange(len(features)) % 2 == 0
    for leaf in (1, 5):
        forest = RandomForestClassifier(200, min_samples_leaf=leaf, random_state=0, n_jobs=2).fit(
            features[half], target[half]
        )
        forest.set_params(n_jobs=1)
        flat = FlatForest.from_trees(forest.estimators_)
        unseen = np.tile(features[~half], (4, 1))
        ours, theirs = race(
            lambda flat=flat, unseen=unseen: flat.predict_proba(unseen),
            lambda forest=forest, unseen=unseen: clock(lambda: forest.predict_proba(unseen)),
            repeats,
        )
        difference = float(np.abs(flat.predict_proba(unseen) - forest.predict_proba(unseen)).max())
        name = f"200 trees of {len(flat.feature) // 200} nodes, diff {difference:.0e}"
        report(name, len(unseen), ours, "scikit-learn", theirs)


FORESTS = (
    (200, 12_000, 30, 5, 1),
    (200, 12_000, 30, 5, 5),
    (100, 4_000, 30, 5, 20),
    (50, 12_000, 60, 13, 5),
    (20, 30_000, 30, 8, 1),
)
"""Trees, training rows, features, classes and smallest leaf of each forest of the set."""


def race_forests(repeats: int, forests: tuple[tuple[int, ...], ...] = FORESTS, n_rows: int = 24_000) -> None:
    """Race the flat forest against scikit-learn's with one job, on forests that span sizes, by processor time."""
    rng = np.random.default_rng(0)
    for n_trees, n_training, n_features, n_classes, leaf in forests:
        values = rng.normal(size=(n_training + n_rows, n_features)).astype(np.float32)
        noisy = values[:, :4].sum(axis=1) + rng.normal(0, 1, len(values))
        target = np.digitize(noisy, np.linspace(-3, 3, n_classes - 1))[:n_training]
        forest = RandomForestClassifier(n_trees, min_samples_leaf=leaf, random_state=0, n_jobs=1)
        forest.fit(values[:n_training], target)
        flat, unseen = FlatForest.from_trees(forest.estimators_), values[n_training:]
        times: list[list[float]] = [[], []]
        flat.predict_proba(unseen[:10])
        for _ in range(repeats):
            for taken, program in zip(times, (flat, forest), strict=True):
                start = time.process_time()
                program.predict_proba(unseen)
                taken.append(time.process_time() - start)
        nodes = len(flat.feature) // n_trees
        name = f"{n_trees} trees of {nodes} nodes, {n_features} features, {n_classes} classes"
        report(name, len(unseen), median(times[0]), "scikit-learn", median(times[1]))


def main() -> None:
    """Run all races."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scratch", type=Path, default=Path("bench_forest.npy"), help="file for the rival's input")
    arguments = parser.parse_args()
    try:
        race_jakteristics(arguments.repeats, arguments.scratch)
    finally:
        arguments.scratch.unlink(missing_ok=True)
    xyz = load("street_5M")
    owners, adjacency = partition(xyz, 0.6)
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (len(xyz), 3)).astype(np.uint8)
    intensity = rng.random(len(xyz), dtype=np.float32)
    columns = {"rgb": rgb, "intensity": intensity, "height_above_ground": np.ascontiguousarray(xyz[:, 2])}
    features = compute_supervoxel_features(xyz, owners, adjacency, **columns)
    seconds, _ = race(lambda: compute_supervoxel_features(xyz, owners, adjacency, **columns), None, arguments.repeats)
    report(f"{len(features.names)} supervoxel features", len(xyz), seconds)
    seconds, _ = race(lambda: nearest_supervoxels(xyz, features.centroids), None, arguments.repeats)
    report("nearest supervoxel of each point", len(xyz), seconds)
    race_scikit_learn(arguments.repeats, features.values, features.centroids)
    race_forests(arguments.repeats)


if __name__ == "__main__":
    main()
