"""Reference height of the ground filter: the lowest point of a block (the paper) or a robust lower surface.

The lower surface is defined on square cells of several columns. It starts from the lowest column of each cell. Cells
above a slope-limited cone of lower cells are removed (car roofs, crowns, walls without a visible base). Cells that
continue the slope of the ground are added again (embankments). The remaining gaps are filled from their surroundings,
across block borders and one block beyond the points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.ground.blocks import BlockGrid, build_table, neighbour_slots
from mlsroad_pipeline.algorithms.ground.cells import (
    blend,
    cell_lows,
    fill_from_neighbours,
    grow_along_slope,
    lift_to_centres,
    patch_sizes,
    slope_envelope,
)


@dataclass(frozen=True)
class SurfaceParameters:
    """Parameters of the lower surface, see `classify_ground`."""

    slope: float  # Slope of the cones that limit the heights of cells, metres per metre
    step: float  # Tolerance of a cell above the cones, or from the line through its neighbours, metres
    drop: float  # Tolerance below the cones of a cell outside large patches, metres
    share: float  # Fraction of the columns of a cell that must support its lowest height, 0 to 1
    patch: float  # Minimum area of a connected patch whose cells define cones, square metres


@njit(cache=True)
def column_levels(
    rows: NDArray[np.int64], cells: NDArray[np.float32], around: NDArray[np.int32], per_cell: int
) -> NDArray[np.float32]:
    """Return the surface at the centre of each column of the occupied blocks."""
    side = cells.shape[1] * per_cell
    levels = np.empty((len(rows), side, side), dtype=np.float32)
    for block in range(len(rows)):
        for y in range(side):
            for x in range(side):
                levels[block, y, x] = blend(cells, around, rows[block], (y + 0.5) / per_cell, (x + 0.5) / per_cell)
    return levels


@njit(cache=True)
def snap_to_minima(levels: NDArray[np.float32], minima: NDArray[np.float32], step: float) -> NDArray[np.float32]:
    """Return the levels shifted by the lowest offset of the 3 x 3 column minima within `step` of their level.

    This separates the two sides of a curb, which cells blend. Offsets instead of heights preserve slopes. The
    neighbourhood ends at the border of the block.
    """
    side = levels.shape[1]
    surface = levels.copy()
    seen = np.empty((side, side), dtype=np.float32)
    for block in range(len(levels)):
        for y in range(side):
            for x in range(side):
                offset = minima[block, y, x] - levels[block, y, x]
                seen[y, x] = offset if abs(offset) <= step else np.float32(np.inf)
        for y in range(side):
            for x in range(side):
                best = np.float32(np.inf)
                for near_y in range(max(y - 1, 0), min(y + 2, side)):
                    for near_x in range(max(x - 1, 0), min(x + 2, side)):
                        best = min(best, seen[near_y, near_x])
                if best < np.inf:
                    surface[block, y, x] += best
    return surface


def lower_surface(
    grid: BlockGrid, minima: NDArray[np.float32], *, per_cell: int, parameters: SurfaceParameters
) -> NDArray[np.float32]:
    """Estimate the ground height of each column of the occupied blocks."""
    ring = (np.arange(-1, 2)[:, None] * grid.stride + np.arange(-1, 2)).ravel()
    keys = np.unique(grid.keys[:, None] + ring)
    rows = np.searchsorted(keys, grid.keys)
    around = neighbour_slots(keys, *build_table(keys), grid.stride)
    lows = cell_lows(minima, rows, len(keys), per_cell, parameters.share)
    rise = np.float32(parameters.slope * grid.width * per_cell)
    step = np.float32(parameters.step)
    sizes = patch_sizes(lows, around, rise, step)
    enough = min(parameters.patch / (grid.width * per_cell) ** 2, sizes.max())
    envelope = slope_envelope(np.where(sizes >= enough, lows, np.float32(np.nan)), around, rise)
    accepted = (lows - envelope <= step) & (lows - envelope >= -parameters.drop)
    ground = grow_along_slope(lows, accepted, around, step)
    cells = lift_to_centres(fill_from_neighbours(ground, around), around)
    return snap_to_minima(column_levels(rows, cells, around, per_cell), minima, step)


def block_surface(minima: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the lowest height of each block for all of its columns (the reference of the paper)."""
    lowest = minima.min(axis=(1, 2), keepdims=True)
    return np.ascontiguousarray(np.broadcast_to(lowest, minima.shape))
