"""Columns of the table of voxel features: their names, and the parts of the table that belong to one level of cells."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features import voxel_kernels as kernels
from mlsroad_pipeline.algorithms.features.voxel_levels import (
    Cells,
    Columns,
    columns_of,
    halve,
    sum_by_owner,
    sum_windows,
)
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks

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
