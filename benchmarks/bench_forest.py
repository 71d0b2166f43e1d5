"""Speed of neighbourhoods, features and the random forest, compared with jakteristics and scikit-learn.

    python benchmarks/bench_forest.py [--repeats 5]

Without the clouds of $MLSROAD_RIVALS a random street is used. Calls alternate, medians are printed, compilation is not
timed.
"""

import os
import subprocess
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from _common import RIVALS, Timed, cloud_arrays, found_program, parser, race, show, voxel_centroids
from numpy.typing import NDArray
from scipy.sparse import csr_array
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.features.eigen import EIGEN_FEATURES, compute_eigen_features
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features
from mlsroad_pipeline.algorithms.geometry.cells import build_cell_grids
from mlsroad_pipeline.algorithms.geometry.neighbors import radius_neighbors
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import nearest_supervoxels

RADIUS = 0.3

# Runs in the environment of the competing program: one call per line read, so that calls of both can alternate.
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
    if (RIVALS / f"{name}.npz").exists():
        return cloud_arrays(name)["xyz"]
    rng = np.random.default_rng(0)
    xyz = rng.random((500_000, 3)) * [60, 20, 0.02]
    xyz[::10, 2] = rng.random(50_000) * 6
    return xyz.astype(np.float32)


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


def race_jakteristics(repeats: int) -> None:
    """Race all eigenvalue features against those of jakteristics on voxel centroids."""
    xyz = voxel_centroids(load("street_1M_off"), 0.05)
    python = found_program("venv", "bin", "python", module="jakteristics")
    with tempfile.TemporaryDirectory() as folder:
        np.save(scratch := Path(folder) / "xyz.npy", xyz)
        for threads in (1, 2):
            works = {"mlsroad": lambda n=threads: compute_eigen_features(xyz, radius=RADIUS, n_threads=n)}
            process = None
            if python is not None:
                process = subprocess.Popen(
                    [python, "-c", JAKTERISTICS, scratch, str(RADIUS)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                    text=True, env={**os.environ, "OMP_NUM_THREADS": str(threads)},
                )  # fmt: skip

                def other(process=process, threads=threads) -> Timed:
                    process.stdin.write(f"{threads}\n")
                    process.stdin.flush()
                    return Timed(float(process.stdout.readline()), float("nan"))

                works["jakteristics"] = other
            found = race(works, repeats=repeats, warm_up=1)
            show(f"{len(EIGEN_FEATURES)} eigenvalue features, {RADIUS} m", len(xyz), found, threads=threads)
            if process is not None:
                process.communicate()
    works = {"mlsroad": lambda: radius_neighbors(xyz, radius=RADIUS)}
    show(f"radius neighbours as CSR, {RADIUS} m", len(xyz), race(works, repeats=repeats, warm_up=1))


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
        flat.predict_proba(unseen[:10])  # compiles
        works = {"mlsroad": partial(flat.predict_proba, unseen), "scikit-learn": partial(forest.predict_proba, unseen)}
        found = race(works, repeats=repeats)
        largest = float(np.abs(found["mlsroad"].result - found["scikit-learn"].result).max())
        name = f"{n_trees} trees of {len(flat.feature) // n_trees} nodes, {n_features} features, {n_classes} classes"
        show(name, len(unseen), found, processor=True, largest_difference=largest)


def main() -> None:
    """Run all races."""
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=5)
    repeats = arguments.parse_args().repeats
    race_jakteristics(repeats)
    xyz = load("street_5M")
    owners, adjacency = partition(xyz, 0.6)
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (len(xyz), 3)).astype(np.uint8)
    intensity = rng.random(len(xyz), dtype=np.float32)
    columns = {"rgb": rgb, "intensity": intensity, "height_above_ground": np.ascontiguousarray(xyz[:, 2])}
    found = race(
        {"mlsroad": lambda: compute_supervoxel_features(xyz, owners, adjacency, **columns)}, repeats=repeats, warm_up=1
    )
    features = found["mlsroad"].result
    show(f"{len(features.names)} supervoxel features", len(xyz), found)
    works = {"mlsroad": lambda: nearest_supervoxels(xyz, features.centroids)}
    show("nearest supervoxel of each point", len(xyz), race(works, repeats=repeats, warm_up=1))
    race_forests(repeats)


if __name__ == "__main__":
    main()
