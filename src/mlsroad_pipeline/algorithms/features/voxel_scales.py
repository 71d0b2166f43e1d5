"""Features of voxels at five scales, insensitive to the density of the points.

Each voxel counts once on every scale, however many points it holds. Intensities are ranks within the scene. The columns
of the table are those of `voxel_table`.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.features import voxel_kernels as kernels
from mlsroad_pipeline.algorithms.features import voxel_table
from mlsroad_pipeline.algorithms.geometry.cells import spread_owners
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort, rank_few
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_in_chunks


def known_intensity(intensity: NDArray) -> NDArray | None:
    """Return intensities with the median in place of NaN.

    Examples
    --------
    >>> known_intensity(np.array([0.1, np.nan, 0.5, 0.3])).tolist()
    [0.1, 0.3, 0.5, 0.3]
    """
    missing = np.isnan(intensity)
    known = intensity[~missing]
    if not len(known) or known.min() == known.max():
        return None
    return np.where(missing, np.median(known), intensity) if missing.any() else intensity


def rank_within(values: ArrayLike) -> NDArray[np.float64]:
    """Return the rank of each value among all, as a share; equal values share their mean rank."""
    numbers = np.ascontiguousarray(values, dtype=np.float32) + np.float32(0)  # -0 becomes 0
    if np.isnan(numbers).any():
        raise DataError(f"intensity is NaN in row {int(np.argmax(np.isnan(numbers)))}")
    few = rank_few(numbers)
    if few is not None:
        return (few - 0.5) / len(numbers)
    bits = numbers.view(np.int32).astype(np.int64)
    ordered, order = radix_argsort(np.where(bits < 0, -bits - 1, bits + 2**31), 32)
    edge = np.flatnonzero(np.diff(ordered, prepend=ordered[:1] - 1, append=ordered[-1:] + 1))
    ranks = np.empty(len(numbers))
    ranks[order] = np.repeat((edge[1:] + edge[:-1]) / (2 * len(numbers)), np.diff(edge))
    return ranks


@dataclass(frozen=True)
class VoxelFeatures:
    """Features of the voxels of a cloud."""

    # One row a voxel of `rows`. NaN: no intensity, no run above or below, or fewer than three voxels in the window.
    values: NDArray[np.float32]
    owner: NDArray[np.int32]  # Voxel of each point
    cells: voxel_table.Cells  # The voxels
    rows: NDArray[np.int64] | None = None  # Voxels that are described; None is all


def compute_voxel_features(
    xyz: ArrayLike,
    *,
    height: ArrayLike,
    intensity: ArrayLike | None = None,
    voxel_size: float = 0.2,
    wanted: NDArray[np.bool_] | None = None,
    around: int | None = None,
    n_threads: int = 1,
) -> VoxelFeatures:
    """Compute the features of the voxels of a cloud."""
    check_positive(voxel_size, "voxel_size")
    check_threads(n_threads)
    points = check_xyz(xyz)
    heights = check_column(height, len(points), "height")
    heights = heights.astype(np.float64 if heights.dtype != np.float32 else np.float32, copy=False)
    names = voxel_table.voxel_feature_names()
    if len(points) == 0:
        empty = voxel_table.Cells(np.zeros(0, np.int64), np.zeros((0, 3), np.int32), (1, 1, 1))
        return VoxelFeatures(np.zeros((0, len(names)), np.float32), np.zeros(0, np.int32), empty)
    ranks = np.zeros(0) if intensity is None else rank_within(check_column(intensity, len(points), "intensity"))
    cells, order, starts, minimum = voxel_table.find_voxels(points, voxel_size)
    moments, voxel_heights = np.empty((len(cells), kernels.N_MOMENTS)), np.empty(len(cells))
    owner = spread_owners(order, starts)
    rows = None if wanted is None else _wanted_voxels(cells, owner[wanted], around, n_threads)
    described = slice(None) if rows is None else rows
    sums = kernels.sum_voxels(points, minimum, heights, ranks, owner, len(cells))
    own = kernels.describe_voxels(sums, starts, len(ranks) > 0, moments, voxel_heights)[described]
    table = np.empty((len(own), len(names)), np.float32)
    table[:, : len(voxel_table.VOXEL_COLUMNS)] = own
    extremes = np.stack([voxel_heights, voxel_heights, moments[:, 3]])
    level = voxel_table.Level(cells, moments, extremes, np.arange(len(cells), dtype=np.int32), voxel_size, described)
    own_moments, at = moments[described], len(voxel_table.VOXEL_COLUMNS)
    for number in range(voxel_table.N_LEVELS):
        level = level if number == 0 else level.coarser()
        at = voxel_table.write_level(level, number, own_moments, voxel_heights, len(ranks) > 0, table, at, n_threads)
        at = voxel_table.write_surroundings(level, number, voxel_heights, table, at, n_threads)
    voxel_table.write_surroundings(level.coarser(), voxel_table.N_LEVELS, voxel_heights, table, at, n_threads)
    return VoxelFeatures(table, owner, cells, rows)


def _wanted_voxels(
    cells: voxel_table.Cells, wanted: NDArray[np.int32], around: int | None, n_threads: int
) -> NDArray[np.int64]:
    """Return the voxels that are wanted or smooth those that are, ascending."""
    flags = np.zeros(len(cells), np.bool_)
    flags[wanted] = True
    if around is not None:
        flags = _mean_around(cells, flags[:, None].astype(np.float64), around, n_threads)[:, 0] > 0
    return np.flatnonzero(flags)


def smooth_by_cells(
    features: VoxelFeatures, values: NDArray[np.floating], *, level: int, n_threads: int = 1
) -> NDArray[np.float64]:
    """Return the mean of values over the voxels in the 27 cells of a level around each voxel."""
    return _mean_around(features.cells, values, level, n_threads)


def _mean_around(
    cells: voxel_table.Cells, values: NDArray[np.floating], level: int, n_threads: int
) -> NDArray[np.float64]:
    """Return `smooth_by_cells` of voxels."""
    owner = np.arange(len(cells), dtype=np.int32)
    for _ in range(level):
        cells, parent = voxel_table.halve(cells)
        owner = parent[owner]
    counted = np.column_stack([values, np.ones(len(values))])
    sums = voxel_table.sum_by_owner(owner, counted, len(cells))
    wide = np.empty_like(sums)
    run_in_chunks(partial(_windows, cells.keys, cells.rows(1), sums, wide), len(cells), n_threads=n_threads)
    return (wide[:, :-1] / wide[:, -1:])[owner]


def _windows(keys: NDArray, rows: NDArray, values: NDArray, out: NDArray, first: int, last: int) -> None:
    voxel_table.sum_windows(keys, rows, 1, values, first, last, out)
