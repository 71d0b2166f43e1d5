"""Cells of the ground: the lowest points of each, and a coarse grid to search them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cell_grid import CellGrid, build_cell_grids

CELL = 0.1
"""Edge of a cell, metres: a third of the narrowest kerb stone, so that a kerb is one step between two cells."""

BLOCK = 0.5
"""Edge of the coarse grid, metres."""

_BAND = 0.05  # metres above the lowest point of a cell: the foot of a kerb, not grass or a wheel above it


@dataclass(frozen=True)
class GroundCells:
    """Occupied cells of the ground of a scene."""

    xyz: NDArray[np.float64]  # Mean of the points up to 5 cm above the lowest of each cell, metres
    points: CellGrid  # The points, sorted into the cells
    blocks: CellGrid  # The cells, sorted into squares of `BLOCK`


def ground_cells(xyz: NDArray[np.floating]) -> GroundCells:
    """Return the cells of the ground."""
    flat = np.array(xyz, dtype=np.float64)
    flat[:, 2] = 0.0
    (points,) = build_cell_grids(flat, cell_size=CELL)
    cells = _lowest(np.ascontiguousarray(xyz, dtype=np.float64), points.order, points.starts)
    plan = cells.copy()
    plan[:, 2] = 0.0
    (blocks,) = build_cell_grids(plan, cell_size=BLOCK, margin=2)
    return GroundCells(cells, points, blocks)


@njit(cache=True, nogil=True)
def _lowest(xyz: NDArray, order: NDArray, starts: NDArray) -> NDArray[np.float64]:
    means = np.zeros((len(starts) - 1, 3))
    for cell in range(len(means)):
        low = np.inf
        for i in range(starts[cell], starts[cell + 1]):
            low = min(low, xyz[order[i], 2])
        count = 0
        for i in range(starts[cell], starts[cell + 1]):
            if xyz[order[i], 2] <= low + _BAND:
                count += 1
                for axis in range(3):
                    means[cell, axis] += xyz[order[i], axis]
        means[cell] /= count
    return means


MOST_CELLS = (5 * round(BLOCK / CELL) + 2) ** 2  # the edges of blocks are not those of cells
"""Largest number of cells in 5 by 5 blocks."""
