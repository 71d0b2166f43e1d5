"""Time and memory of the normalised cut on one cluster of a million voxels.

    python benchmarks/large_clusters.py

Two clouds form a single cluster each: a solid block with a point in every voxel, which has the largest number of edges,
and a wood of connected crowns with many stems. Each is segmented in a separate process; the memory is the peak of that
process, including Python and the compiled kernels.
"""

from __future__ import annotations

import multiprocessing
import resource
import time

import numpy as np
from mlsroad_pipeline.algorithms.segmentation.cut_parameters import NormalizedCutParameters
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import cluster_points, segment

SIDE = 100  # voxels
TREES = 16  # along each side of the wood
APART, CROWN, LEAVES = 5.0, (3.0, 3.0, 2.5), 6_000  # metres between trees, half axes of a crown, points in it


def block(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return one point in each voxel of a cube."""
    steps = np.arange(SIDE) * 0.1 + 0.05
    lattice = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return lattice + rng.uniform(-0.01, 0.01, lattice.shape)


def wood(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return trees in rows, with trunks of 4 m below overlapping crowns."""
    side = np.arange(TREES) * APART
    feet = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 1, 2)
    height = np.tile(np.repeat(np.arange(0, 4, 0.05), 4), (len(feet), 1))
    trunk = np.concatenate([feet + rng.normal(0, 0.08, (*height.shape, 2)), height[..., None]], axis=-1)
    away = rng.normal(size=(len(feet), LEAVES, 3))
    away *= rng.random((len(feet), LEAVES, 1)) ** (1 / 3) / np.linalg.norm(away, axis=-1, keepdims=True)
    crown = away * CROWN + np.concatenate([feet, np.full_like(feet[..., :1], 6.0)], axis=-1)
    return np.concatenate([trunk.reshape(-1, 3), crown.reshape(-1, 3)])


def measure(cloud: str) -> None:
    """Segment one of the clouds, and print time and memory."""
    rng = np.random.default_rng(1)
    segment(rng.random((1000, 3)), intensity=rng.random(1000))  # compiles
    xyz = {"block": block, "wood": wood}[cloud](rng)
    start = time.perf_counter()
    n_objects = len(np.unique(segment(xyz, intensity=rng.random(len(xyz)))))
    seconds, peak = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    parameters = NormalizedCutParameters()
    largest = np.bincount(cluster_points(xyz, parameters))
    n_voxels = len(build_voxel_grid(xyz, voxel_size=parameters.voxel_size).centroids)
    print(
        f"{cloud}: {len(xyz):,} points in {n_voxels:,} voxels, {largest.max() / len(xyz):.1%} of them one cluster;"
        f" {n_objects} objects, {seconds:.1f} s, {peak:.2f} GiB"
    )


def main() -> None:
    """Run."""
    context = multiprocessing.get_context("spawn")
    for cloud in ("block", "wood"):
        process = context.Process(target=measure, args=(cloud,))
        process.start()
        process.join()
        if process.exitcode != 0:
            raise SystemExit(f"{cloud}: ended with {process.exitcode}")


if __name__ == "__main__":
    main()
