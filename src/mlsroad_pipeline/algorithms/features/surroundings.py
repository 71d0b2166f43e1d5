"""Shape features of spherical neighbourhoods of supervoxels at several radii.

Supervoxels far from the scanner have few points, and their moments are unreliable. Neighbourhoods of several sizes
(compared by Weinmann et al. 2015) are more robust. Counting occupied voxels instead of points makes the features
independent of scan density.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.eigen import MINIMUM_NEIGHBORS, SHAPE_FEATURES, gather_near, sum_ball
from mlsroad_pipeline.algorithms.features.normals import ORIENTATION_FEATURES, describe_shape
from mlsroad_pipeline.algorithms.geometry.cells import (
    CELLS_PER_RADIUS,
    build_cell_grids,
    first_window,
    most_near,
    move_window,
)
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid

BALL_FEATURES = (*SHAPE_FEATURES, *ORIENTATION_FEATURES, "horizontal_linearity")
"""Features of `describe_balls`, whose names have the suffix ``_<radius>m``."""


def ball_feature_names(radii: Sequence[float]) -> tuple[str, ...]:
    """Return the names of the columns of `describe_balls`."""
    return tuple(f"{name}_{radius:g}m" for radius in radii for name in BALL_FEATURES)


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_balls(
    keys: NDArray,
    starts: NDArray,
    local: NDArray,
    q_order: NDArray,
    q_keys: NDArray,
    q_starts: NDArray,
    q_local: NDArray,
    size: float,
    rows: NDArray,
    reach: int,
    radii: NDArray,
    first: int,
    last: int,
    covariances: NDArray,
    counts: NDArray,
) -> None:
    """Write the covariances of the voxels around the queries in cells `first` to `last`, for each radius."""
    begin, end = first_window(keys, q_keys[first], rows, reach)
    near_x = np.empty(1, np.float32)
    near_y, near_z = near_x, near_x
    largest = radii[0]
    for r in range(1, len(radii)):
        largest = max(largest, radii[r])
    widest = np.float32(largest**2)
    for cell in range(first, last):
        move_window(keys, q_keys[cell], rows, reach, begin, end)
        bound = most_near(starts, begin, end)
        if bound > len(near_x):
            near_x = np.empty(2 * bound, np.float32)
            near_y, near_z = np.empty_like(near_x), np.empty_like(near_x)
        n_near = gather_near(local, starts, begin, end, rows, keys, q_keys[cell], size, widest, near_x, near_y, near_z)
        for i in range(q_starts[cell], q_starts[cell + 1]):
            x, y, z = q_local[0, i], q_local[1, i], q_local[2, i]
            for r in range(len(radii)):
                squared = np.float32(radii[r] ** 2)
                sum_ball(near_x, near_y, near_z, n_near, x, y, z, squared, covariances[r], counts[r], q_order[i])


def _horizontal_linearity(covariances: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return 1 - l2 / l1 of the covariance in plan: near 1 for walls, near 0 for tree crowns."""
    xx, xy, yy = covariances[0], covariances[1], covariances[3]
    mean, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (1.0 - np.maximum(mean - spread, 0.0) / (mean + spread)).astype(np.float32)


def describe_balls(
    xyz: NDArray[np.floating],
    centroids: NDArray[np.float64],
    *,
    radii: Sequence[float],
    voxel_size: float,
    voxels: NDArray[np.float64] | None = None,
    n_threads: int = 1,
) -> NDArray[np.float32]:
    """Compute shape features of the occupied voxels within given radii of each supervoxel."""
    if voxels is None:
        voxels = build_voxel_grid(xyz, voxel_size=voxel_size, n_threads=n_threads).centroids
    size = max(radii) * (1 + 1e-6) / CELLS_PER_RADIUS
    grid, queries = build_cell_grids(voxels, centroids, cell_size=size, margin=CELLS_PER_RADIUS)
    rows = grid.row_offsets(CELLS_PER_RADIUS)
    n, scales = len(centroids), np.array(radii, dtype=np.float64)
    covariances = np.empty((len(scales), 6, n))
    counts = np.empty((len(scales), n), np.float32)

    def run(first: int, last: int) -> None:
        _sum_balls(
            grid.keys, grid.starts, grid.local, queries.order, queries.keys, queries.starts, queries.local, size, rows,
            CELLS_PER_RADIUS, scales, first, last, covariances, counts,
        )  # fmt: skip

    run_in_chunks(run, len(queries.keys), n_threads=n_threads)
    return np.hstack([_describe_scale(covariances[r], counts[r]) for r in range(len(scales))])


def _describe_scale(covariances: NDArray[np.float64], counts: NDArray[np.float32]) -> NDArray[np.float32]:
    from_above = np.where(counts >= MINIMUM_NEIGHBORS, _horizontal_linearity(covariances), np.float32(np.nan))
    return np.hstack([describe_shape(covariances, counts), from_above[:, None]])
