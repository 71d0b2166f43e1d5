"""Table of voxel features: levels of cells, names of columns, and the parts of the table that belong to one level."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.features import voxel_kernels as kernels
from mlsroad_pipeline.algorithms.geometry.cells import (
    bounding_box,
    first_window,
    move_window,
    run_starts,
    spread_owners,
)
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks

MARGIN = 4
"""Empty cells around the occupied ones: windows of up to three cells do not wrap into the next column."""
_MAX_CELLS = 2**62


@dataclass(frozen=True)
class Cells:
    """Occupied cells of one level."""

    keys: NDArray[np.int64]  # Ascending keys ``(ix * ny + iy) * nz + iz``
    index: NDArray[np.int32]  # ix, iy and iz, from 0, without the margin
    shape: tuple[int, int, int]  # (nx, ny, nz), including margins

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.keys)

    def rows(self, reach: int) -> NDArray[np.int64]:
        """Return (dx, dy, key offset) of the columns up to `reach` cells away, shape (r, 3), for `move_window`."""
        _, ny, nz = self.shape
        steps = range(-reach, reach + 1)
        return np.array([(dx, dy, (dx * ny + dy) * nz) for dx in steps for dy in steps], dtype=np.int64)


@dataclass(frozen=True)
class Columns:
    """Occupied columns of one level, the cells with equal ix and iy."""

    keys: NDArray[np.int64]  # Ascending keys ``ix * ny + iy``
    of_cell: NDArray[np.int32]  # Column of each cell
    ny: int  # Factor of the keys

    def rows(self, reach: int) -> NDArray[np.int64]:
        """Return (dx, 0, key offset) of the rows of columns up to `reach` away, for `move_window`."""
        return np.array([(dx, 0, dx * self.ny) for dx in range(-reach, reach + 1)], dtype=np.int64)


def find_voxels(
    xyz: NDArray[np.floating], voxel_size: float
) -> tuple[Cells, NDArray[np.int32], NDArray[np.int64], NDArray[np.float64]]:
    """Sort points into voxels."""
    box = bounding_box(xyz)
    nx, ny, nz = (int(length) + 2 + 2 * MARGIN for length in ((box[1] - box[0]) // voxel_size).tolist())
    if nx * ny * nz > _MAX_CELLS:
        raise DataError(f"an extent of {(box[1] - box[0]).tolist()} m is too large for voxels of {voxel_size} m")
    point_keys = _point_keys(xyz, box[0], voxel_size, ny, nz)
    sorted_keys, order = radix_argsort(point_keys, (nx * ny * nz).bit_length())
    starts = run_starts(sorted_keys)
    keys = sorted_keys[starts[:-1]]
    return Cells(keys, _indices(keys, ny, nz), (nx, ny, nz)), order, starts, box[0]


def halve(cells: Cells) -> tuple[Cells, NDArray[np.int32]]:
    """Return the cells of the next level."""
    nx, ny, nz = (int(n) // 2 + 1 + 2 * MARGIN for n in cells.shape)
    fine_keys = _halved_keys(cells.index, ny, nz)
    sorted_keys, order = radix_argsort(fine_keys, (nx * ny * nz).bit_length())
    starts = run_starts(sorted_keys)
    keys = sorted_keys[starts[:-1]]
    return Cells(keys, _indices(keys, ny, nz), (nx, ny, nz)), spread_owners(order, starts)


def columns_of(cells: Cells) -> Columns:
    """Return the columns of cells."""
    column_keys = cells.keys // cells.shape[2]
    starts = run_starts(column_keys)
    of_cell = spread_owners(np.arange(len(cells), dtype=np.int32), starts)
    return Columns(column_keys[starts[:-1]], of_cell, cells.shape[1])


@njit(cache=True, nogil=True)
def _point_keys(xyz: NDArray, minimum: NDArray, size: float, ny: int, nz: int) -> NDArray[np.int64]:
    keys = np.empty(len(xyz), np.int64)
    for i in range(len(xyz)):
        ix = np.int64((xyz[i, 0] - minimum[0]) / size) + MARGIN
        iy = np.int64((xyz[i, 1] - minimum[1]) / size) + MARGIN
        iz = np.int64((xyz[i, 2] - minimum[2]) / size) + MARGIN
        keys[i] = (ix * ny + iy) * nz + iz
    return keys


@njit(cache=True, nogil=True)
def _halved_keys(index: NDArray, ny: int, nz: int) -> NDArray[np.int64]:
    keys = np.empty(len(index), np.int64)
    for i in range(len(index)):
        ix, iy, iz = np.int64(index[i, 0] >> 1), np.int64(index[i, 1] >> 1), np.int64(index[i, 2] >> 1)
        keys[i] = ((ix + MARGIN) * ny + iy + MARGIN) * nz + iz + MARGIN
    return keys


@njit(cache=True, nogil=True)
def _indices(keys: NDArray, ny: int, nz: int) -> NDArray[np.int32]:
    index = np.empty((len(keys), 3), np.int32)
    for i in range(len(keys)):
        column = keys[i] // nz
        index[i, 0], index[i, 1], index[i, 2] = column // ny - MARGIN, column % ny - MARGIN, keys[i] % nz - MARGIN
    return index


@njit(cache=True, nogil=True)
def sum_by_owner(owner: NDArray, values: NDArray, n_groups: int) -> NDArray[np.float64]:
    """Return the sums (groups, m) of the rows of `values` (n, m)."""
    sums = np.zeros((n_groups, values.shape[1]))
    for i in range(len(owner)):
        for j in range(values.shape[1]):
            sums[owner[i], j] += values[i, j]
    return sums


@njit(cache=True, nogil=True)
def sum_windows(keys: NDArray, rows: NDArray, reach: int, values: NDArray, first: int, last: int, out: NDArray) -> None:
    """Write the sums of `values` (c, m) over the window of each cell from `first` to `last`."""
    if first >= last:
        return
    begin, end = first_window(keys, keys[first], rows, reach)
    for i in range(first, last):
        move_window(keys, keys[i], rows, reach, begin, end)
        out[i] = 0.0
        for j in range(len(rows)):
            for p in range(begin[j], end[j]):
                for q in range(values.shape[1]):
                    out[i, q] += values[p, q]


N_LEVELS = 5
"""Levels with shapes: voxels and four times cells of twice the edge."""
_INTENSITY, _SLICES, _RUNS, _RELIEF = (1, 3), (1, 2, 3), (1, 2), (3, 4)
_SURROUNDINGS = ((4, 1), (5, 1), (5, 3))
"""Level and reach in columns of the three surroundings."""
VOXEL_COLUMNS = ("height", "count", "thickness", "intensity", "intensity_max")
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
    """Return the names of the columns of the table."""
    levels = [f"{name}_s{level}" for level in range(N_LEVELS) for name in _level_names(level)]
    return [*VOXEL_COLUMNS, *levels, *(f"wide_{level}_{reach}_{n}" for level, reach in _SURROUNDINGS for n in _CONTEXT)]


def intensity_columns() -> NDArray[np.int64]:
    """Return the columns of the table that are NaN without intensity."""
    return np.flatnonzero([name.startswith("intensity") for name in voxel_feature_names()])


@dataclass
class Level:
    """Cells of one level, and what the columns of the level are computed from."""

    cells: Cells  # The c cells of the level
    moments: NDArray[np.float64]  # Sums over the voxels of each cell
    # Lowest and highest height above ground of the voxels of each cell, and lowest mean z of a voxel, metres
    extremes: NDArray[np.float64]
    owner: NDArray[np.int32]  # Cell of each voxel
    size: float  # Edge of a cell, metres
    rows: NDArray[np.int64] | slice  # Voxels with a row of the table
    columns: Columns = field(init=False)  # The vertical columns of cells

    def __post_init__(self) -> None:
        self.columns = columns_of(self.cells)

    def coarser(self) -> Level:
        """Return the next level."""
        cells, parent = halve(self.cells)
        moments = sum_by_owner(parent, self.moments, len(cells))
        extremes = kernels.lowest_and_highest(parent, *self.extremes, len(cells))
        return Level(cells, moments, extremes, parent[self.owner], 2 * self.size, self.rows)


def write_level(
    level: Level,
    number: int,
    moments: NDArray[np.float64],
    heights: NDArray[np.float64],
    with_intensity: bool,
    table: NDArray[np.float32],
    at: int,
    n_threads: int,
) -> int:
    """Write the columns of the shapes of one level."""
    owner, heights = level.owner[level.rows], heights[level.rows]
    run = partial(run_in_chunks, n_items=len(table), n_threads=n_threads)
    shapes, means = np.empty((len(level.cells), kernels.N_SHAPES), np.float32), np.empty((len(level.cells), 3))
    describe = partial(
        kernels.describe_cells, level.cells.keys, level.cells.rows(1), level.moments, level.size, shapes, means
    )
    run_in_chunks(describe, len(level.cells), n_threads=n_threads)
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
    run(partial(kernels.copy_rows, owner, shapes, target, table))
    run(partial(kernels.write_offsets, owner, moments, means, level.size, offsets, table))
    if number in _RUNS:
        runs = np.empty((len(level.cells), kernels.N_RUNS), np.float32)
        kernels.describe_runs(level.cells.index, level.extremes[0], level.extremes[1], runs)
        run(partial(kernels.copy_rows, owner, runs, at + np.arange(kernels.N_RUNS), table))
        at += kernels.N_RUNS
    if number == 0:
        return at
    own, near = _column_extremes(level, 1)
    relief = number in _RELIEF
    column = level.columns.of_cell[owner]
    run(partial(kernels.write_columns, column, own, near, moments, heights, relief, at, table))
    return at + len(_COLUMN) + relief


def _column_extremes(level: Level, reach: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the extremes of each column, and over the window of each column."""
    columns = level.columns
    own = kernels.lowest_and_highest(columns.of_cell, *level.extremes, len(columns.keys))
    return own, kernels.widen_extremes(columns.keys, columns.rows(reach), reach, own)


def write_surroundings(
    level: Level,
    number: int,
    heights: NDArray[np.float64],
    table: NDArray[np.float32],
    at: int,
    n_threads: int,
) -> int:
    """Write the columns of the surroundings that belong to one level."""
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
        run_in_chunks(write, len(table), n_threads=n_threads)
        at += len(_CONTEXT)
    return at
