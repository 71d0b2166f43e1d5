"""Features of voxels at five scales, insensitive to the density of the points.

Each voxel counts once on every scale, however many points it holds. Intensities are ranks within the scene. The columns
of the table are listed by `voxel_feature_names`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.features import voxel_kernels as kernels
from mlsroad_pipeline.algorithms.features.voxel_levels import (
    Cells,
    Columns,
    columns_of,
    find_voxels,
    halve,
    spread_owners,
    sum_by_owner,
    sum_windows,
)
from mlsroad_pipeline.algorithms.geometry.cell_grid import check_threads, run_in_chunks
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort, rank_few

N_LEVELS = 5
"""Levels with shapes: voxels and four times cells of twice the edge."""
_INTENSITY, _SLICES, _RUNS, _RELIEF = (1, 3), (1, 2, 3), (1, 2), (3, 4)
_SURROUNDINGS = ((4, 1), (5, 1), (5, 3))
"""Level and reach in columns of the three surroundings."""
_VOXEL = ("height", "count", "thickness", "intensity", "intensity_max")
_SHAPE = (
    "linearity", "planarity", "scattering", "normal_z", "main_z", "longest", "shortest", "spread_z", "spread_wide",
    "spread_narrow", "number",
)  # fmt: skip
_RUN = ("run_bottom", "run_top", "run_length", "run_fill", "gap_above", "gap_below")
_COLUMN = ("to_top", "to_bottom", "to_top_near", "to_bottom_near")
_CONTEXT = (*(f"band_{b}" for b in range(kernels.N_BANDS)), "top", "height_by_top", "number")


def _level_names(level: int) -> list[str]:
    names = [*_SHAPE, "offset_z", "offset_plan"]
    names += ["intensity_mean", "intensity_spread"] if level in _INTENSITY else []
    names += ["slice_wide", "slice_narrow", "slice_number"] if level in _SLICES else []
    names += _RUN if level in _RUNS else ()
    names += _COLUMN if level > 0 else ()
    return names + (["relief"] if level in _RELIEF else [])


def voxel_feature_names() -> list[str]:
    """Return the names of the columns of the table.

    Returns
    -------
    list of str
        ``<feature>`` for a single voxel, ``<feature>_s<level>`` for the window of a level, and
        ``wide_<level>_<reach>_<feature>`` for the surroundings.
    """
    levels = [f"{name}_s{level}" for level in range(N_LEVELS) for name in _level_names(level)]
    return [*_VOXEL, *levels, *(f"wide_{level}_{reach}_{n}" for level, reach in _SURROUNDINGS for n in _CONTEXT)]


def intensity_columns() -> NDArray[np.int64]:
    """Return the columns of the table that are NaN without intensity.

    Returns
    -------
    ndarray of int64
        Their numbers.
    """
    return np.flatnonzero([name.startswith("intensity") for name in voxel_feature_names()])


@dataclass(frozen=True)
class VoxelFeatures:
    """Features of the voxels of a cloud.

    Attributes
    ----------
    values : ndarray of float32, shape (v, f)
        One row a voxel of `rows`. NaN: no intensity, no run above or below, or fewer than three voxels in the window.
    owner : ndarray of int32, shape (n,)
        Voxel of each point.
    cells : Cells
        The voxels.
    rows : ndarray of int64, shape (v,), optional
        Voxels that are described; None is all.
    """

    values: NDArray[np.float32]
    owner: NDArray[np.int32]
    cells: Cells
    rows: NDArray[np.int64] | None = None


@dataclass
class _Level:
    """State of one level while the table is written."""

    cells: Cells
    moments: NDArray[np.float64]
    extremes: NDArray[np.float64]
    owner: NDArray[np.int32]
    size: float
    rows: NDArray[np.int64] | slice  # voxels with a row of the table
    columns: Columns = field(init=False)

    def __post_init__(self) -> None:
        self.columns = columns_of(self.cells)

    def coarser(self) -> _Level:
        """Return the next level."""
        cells, parent = halve(self.cells)
        moments = sum_by_owner(parent, self.moments, len(cells))
        extremes = kernels.lowest_and_highest(parent, *self.extremes, len(cells))
        return _Level(cells, moments, extremes, parent[self.owner], 2 * self.size, self.rows)


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
    """Compute the features of the voxels of a cloud.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres, z up.
    height : array-like of shape (n,)
        Height above the ground, metres; NaN counts as 0.
    intensity : array-like of shape (n,), optional
        Intensity in any unit; only its order within the cloud is used.
    voxel_size : float, default 0.2
        Edge of a voxel, metres. Cells of the other levels have 2, 4, 8 and 16 times the edge.
    wanted : ndarray of bool, shape (n,), optional
        Points whose voxels are described; the others only surround them. None is all.
    around : int, optional
        Level of `smooth_by_cells`: voxels that smooth those of wanted points are described too. None is no smoothing.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    VoxelFeatures
        Table, voxel of each point, and the voxels.

    Raises
    ------
    DataError
        If a coordinate is not finite, a column has another length, or the extent is too large for the voxels.
    ParameterError
        If `voxel_size` is not above zero or `n_threads` is below 1.
    """
    check_positive(voxel_size, "voxel_size")
    check_threads(n_threads)
    points = check_xyz(xyz)
    heights = check_column(height, len(points), "height")
    heights = heights.astype(np.float64 if heights.dtype != np.float32 else np.float32, copy=False)
    names = voxel_feature_names()
    if len(points) == 0:
        empty = Cells(np.zeros(0, np.int64), np.zeros((0, 3), np.int32), (1, 1, 1))
        return VoxelFeatures(np.zeros((0, len(names)), np.float32), np.zeros(0, np.int32), empty)
    ranks = np.zeros(0) if intensity is None else rank_within(check_column(intensity, len(points), "intensity"))
    cells, order, starts, minimum = find_voxels(points, voxel_size)
    moments, voxel_heights = np.empty((len(cells), kernels.N_MOMENTS)), np.empty(len(cells))
    owner = spread_owners(order, starts)
    rows = None if wanted is None else _wanted_voxels(cells, owner[wanted], around, n_threads)
    described = slice(None) if rows is None else rows
    sums = kernels.sum_voxels(points, minimum, heights, ranks, owner, len(cells))
    own = kernels.describe_voxels(sums, starts, len(ranks) > 0, moments, voxel_heights)[described]
    table = np.empty((len(own), len(names)), np.float32)
    table[:, : len(_VOXEL)] = own
    extremes = np.stack([voxel_heights, voxel_heights, moments[:, 3]])
    level = _Level(cells, moments, extremes, np.arange(len(cells), dtype=np.int32), voxel_size, described)
    own_moments, at = moments[described], len(_VOXEL)
    for number in range(N_LEVELS):
        level = level if number == 0 else level.coarser()
        at = _write_level(level, number, own_moments, voxel_heights, len(ranks) > 0, table, at, n_threads)
        at = _write_wide(level, number, voxel_heights, table, at, n_threads)
    _write_wide(level.coarser(), N_LEVELS, voxel_heights, table, at, n_threads)
    return VoxelFeatures(table, owner, cells, rows)


def _wanted_voxels(cells: Cells, wanted: NDArray[np.int32], around: int | None, n_threads: int) -> NDArray[np.int64]:
    """Return the voxels that are wanted or smooth those that are, ascending."""
    flags = np.zeros(len(cells), np.bool_)
    flags[wanted] = True
    if around is not None:
        flags = _mean_around(cells, flags[:, None].astype(np.float64), around, n_threads)[:, 0] > 0
    return np.flatnonzero(flags)


def known_intensity(intensity: NDArray) -> NDArray | None:
    """Return intensities with the median in place of NaN.

    Parameters
    ----------
    intensity : ndarray of shape (n,)
        Intensities of a scene.

    Returns
    -------
    ndarray of shape (n,), or None
        The intensities; None if fewer than two known values differ.

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
    """Return the rank of each value among all, as a share; equal values share their mean rank.

    Parameters
    ----------
    values : array-like of shape (n,)
        Numbers; compared as float32.

    Returns
    -------
    ndarray of float64, shape (n,)
        Share of smaller values plus half the share of equal ones.

    Raises
    ------
    DataError
        If a value is NaN.
    """
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


def smooth_by_cells(
    features: VoxelFeatures, values: NDArray[np.floating], *, level: int, n_threads: int = 1
) -> NDArray[np.float64]:
    """Return the mean of values over the voxels in the 27 cells of a level around each voxel.

    Parameters
    ----------
    features : VoxelFeatures
        The voxels.
    values : ndarray of shape (v, m)
        Values of the voxels.
    level : int
        Level of the cells; 0 is that of the voxels, each further one doubles the edge.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of float64, shape (v, m)
        The means; voxels of one cell share them.
    """
    return _mean_around(features.cells, values, level, n_threads)


def _mean_around(cells: Cells, values: NDArray[np.floating], level: int, n_threads: int) -> NDArray[np.float64]:
    """Return `smooth_by_cells` of voxels."""
    owner = np.arange(len(cells), dtype=np.int32)
    for _ in range(level):
        cells, parent = halve(cells)
        owner = parent[owner]
    counted = np.column_stack([values, np.ones(len(values))])
    sums = sum_by_owner(owner, counted, len(cells))
    wide = np.empty_like(sums)
    _run(partial(_windows, cells.keys, cells.rows(1), sums, wide), len(cells), n_threads)
    return (wide[:, :-1] / wide[:, -1:])[owner]


def _windows(keys: NDArray, rows: NDArray, values: NDArray, out: NDArray, first: int, last: int) -> None:
    sum_windows(keys, rows, 1, values, first, last, out)


def _run(kernel: partial[None], n_items: int, n_threads: int) -> None:
    run_in_chunks(kernel, n_items, n_threads=n_threads)


def _write_level(
    level: _Level,
    number: int,
    moments: NDArray[np.float64],
    heights: NDArray[np.float64],
    with_intensity: bool,
    table: NDArray[np.float32],
    at: int,
    n_threads: int,
) -> int:
    """Write the columns of one level and return the first column after them."""
    n, owner, heights = len(table), level.owner[level.rows], heights[level.rows]
    shapes, means = np.empty((len(level.cells), kernels.N_SHAPES), np.float32), np.empty((len(level.cells), 3))
    describe = partial(
        kernels.describe_cells, level.cells.keys, level.cells.rows(1), level.moments, level.size, shapes, means
    )
    _run(describe, len(level.cells), n_threads)
    if not with_intensity:
        shapes[:, 11:13] = np.nan
    target = np.full(kernels.N_SHAPES, -1)
    target[: len(_SHAPE)] = at + np.arange(len(_SHAPE))
    offsets = at + len(_SHAPE)
    at = offsets + 2
    for columns, levels in ((slice(11, 13), _INTENSITY), (slice(13, 16), _SLICES)):
        if number in levels:
            size = columns.stop - columns.start
            target[columns] = at + np.arange(size)
            at += size
    _run(partial(kernels.copy_rows, owner, shapes, target, table), n, n_threads)
    _run(partial(kernels.write_offsets, owner, moments, means, level.size, offsets, table), n, n_threads)
    if number in _RUNS:
        runs = np.empty((len(level.cells), kernels.N_RUNS), np.float32)
        kernels.describe_runs(level.cells.index, level.extremes[0], level.extremes[1], runs)
        _run(partial(kernels.copy_rows, owner, runs, at + np.arange(kernels.N_RUNS), table), n, n_threads)
        at += kernels.N_RUNS
    if number == 0:
        return at
    own, near = _column_extremes(level, 1)
    relief = number in _RELIEF
    column = level.columns.of_cell[owner]
    _run(partial(kernels.write_columns, column, own, near, moments, heights, relief, at, table), n, n_threads)
    return at + len(_COLUMN) + relief


def _column_extremes(level: _Level, reach: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the extremes of each column, and over the window of each column."""
    columns = level.columns
    own = kernels.lowest_and_highest(columns.of_cell, *level.extremes, len(columns.keys))
    return own, kernels.widen_extremes(columns.keys, columns.rows(reach), reach, own)


def _write_wide(
    level: _Level,
    number: int,
    heights: NDArray[np.float64],
    table: NDArray[np.float32],
    at: int,
    n_threads: int,
) -> int:
    """Write the surroundings that belong to one level and return the first column after them."""
    columns = level.columns
    column = columns.of_cell[level.owner]
    for of_level, reach in _SURROUNDINGS:
        if of_level != number:
            continue
        counts = kernels.count_bands(column, heights, len(columns.keys))
        bands = np.empty_like(counts)
        sum_windows(columns.keys, columns.rows(reach), reach, counts, 0, len(counts), bands)
        top = _column_extremes(level, reach)[1][1]
        write = partial(kernels.write_surroundings, column[level.rows], bands, top, heights[level.rows], at, table)
        _run(write, len(table), n_threads)
        at += len(_CONTEXT)
    return at
