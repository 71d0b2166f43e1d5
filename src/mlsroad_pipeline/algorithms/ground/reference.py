"""The height that a voxel is measured from: a block's ground as in the paper, or a robust lower surface.

The lower surface lives on square cells of several columns. It starts from the lowest column of each cell, cuts away
what a slope-limited cone standing on lower cells leaves above it (car roofs, crowns, walls seen without their base),
grows back along steps that continue the ground's own slope (banks), and fills the rest from its surroundings, across
block borders and one block beyond the points.
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
    """Parameters of the lower surface; `classify_ground` says what their size does.

    Attributes
    ----------
    slope : float
        Rise of the cones that no cell may stand above, metres per metre.
    step : float
        How far a cell may stand above the cones, or off the line that its neighbours draw, metres.
    drop : float
        How far below the cones a cell may lie that is no patch's part, metres.
    share : float
        Part of a cell's columns that its lowest height needs near it, 0 to 1.
    patch : float
        Area of hanging-together cells that may carry a cone, square metres.
    """

    slope: float
    step: float
    drop: float
    share: float
    patch: float


@njit(cache=True)
def column_levels(
    rows: NDArray[np.int64], cells: NDArray[np.float32], around: NDArray[np.int32], per_cell: int
) -> NDArray[np.float32]:
    """Return the cells' surface at the centre of each column of the occupied blocks."""
    side = cells.shape[1] * per_cell
    levels = np.empty((len(rows), side, side), dtype=np.float32)
    for block in range(len(rows)):
        for y in range(side):
            for x in range(side):
                levels[block, y, x] = blend(cells, around, rows[block], (y + 0.5) / per_cell, (x + 0.5) / per_cell)
    return levels


@njit(cache=True)
def snap_to_minima(levels: NDArray[np.float32], minima: NDArray[np.float32], step: float) -> NDArray[np.float32]:
    """Return the levels shifted by the lowest offset of the 3 x 3 column minima that lie within `step` of their level.

    This is what keeps a curb's two sides apart, which the cells blend. Offsets are taken rather than heights so that a
    slope stays one; columns look no further than their block.
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
    """Estimate the ground height of every column of the occupied blocks.

    Parameters
    ----------
    grid : BlockGrid
        The occupied blocks.
    minima : ndarray of shape (b, columns, columns), float32
        Lowest z of each column in metres, inf where a column is empty.
    per_cell : int
        Columns along a cell's side; divides the columns of a block.
    parameters : SurfaceParameters
        Slope, step and drop.

    Returns
    -------
    ndarray of shape (b, columns, columns), float32
        Ground height of each column in metres, relative to the grid's origin.
    """
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
    """Return each block's lowest height for all of its columns: the paper's reference.

    Parameters
    ----------
    minima : ndarray of shape (b, columns, columns), float32
        Lowest z of each column in metres, inf where a column is empty.

    Returns
    -------
    ndarray of shape (b, columns, columns), float32
        The lowest minimum of the block, repeated.
    """
    lowest = minima.min(axis=(1, 2), keepdims=True)
    return np.ascontiguousarray(np.broadcast_to(lowest, minima.shape))
