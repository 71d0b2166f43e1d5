"""Ground that a survey comes with: its contradictions, and what fills the places that it does not cover."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers

CELL, AROUND, REACH = 1.0, 10.0, 5.0
"""Edge of the cells whose lowest ground point counts; radius of the surroundings, and farthest ground, in plan, m."""
MOST_ABOVE = 2.0
"""Height above the surrounding ground from which a ground point contradicts itself, metres."""
_NEIGHBOURS = 330  # at least the number of cells within `AROUND`


def _columns(xyz: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the occupied cells in plan, counted from the first ones, and the cell of each point."""
    ij = [np.floor(axis / CELL).astype(np.int64) for axis in xyz[:, :2].T]
    i, j = (part - part.min() for part in ij)
    width = int(j.max()) + 1
    key, cell = rank_integers(i * width + j)
    return np.column_stack(np.divmod(key, width)), cell


def lifted_ground(xyz: NDArray[np.floating], ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which ground points lie more than `MOST_ABOVE` above the median of the ground around them.

    The ground of a cell of 1 m is its lowest ground point; the median is that of the cells within 10 m, so that evenly
    sloping ground is not counted.

    Examples
    --------
    >>> x, y = (side.ravel() for side in np.meshgrid(np.arange(9.0), np.arange(9.0)))
    >>> z = 0.4 * x
    >>> z[40] += 4.0
    >>> lifted_ground(np.column_stack([x, y, z]), np.ones(81, bool)).nonzero()[0].tolist()
    [40]
    """
    rows = np.flatnonzero(ground)
    lifted = np.zeros(len(xyz), dtype=np.bool_)
    if not len(rows):
        return lifted
    z = xyz[rows, 2].astype(np.float64)
    column, cell = _columns(xyz[rows])
    lowest = np.full(len(column), np.inf)
    np.minimum.at(lowest, cell, z)
    k = min(_NEIGHBOURS, len(column))
    _, near = cKDTree(column * CELL).query(column * CELL, k=[*range(1, k + 1)], distance_upper_bound=AROUND)
    median = np.nanmedian(np.append(lowest, np.nan)[near], axis=1)
    lifted[rows] = z - median[cell] > MOST_ABOVE
    return lifted


def beyond_ground(xyz: NDArray[np.floating], ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which points have no ground point within `REACH` in plan, up to the size of a cell.

    Examples
    --------
    >>> beyond_ground(np.array([[0.0, 0, 0], [4, 0, 0], [7, 0, 0]]), np.array([True, False, False])).tolist()
    [False, False, True]
    """
    if not ground.any():
        return np.ones(len(xyz), dtype=np.bool_)
    column, cell = _columns(xyz)
    covered = np.zeros(len(column), dtype=np.bool_)
    covered[cell[ground]] = True
    distance, _ = cKDTree(column[covered] * CELL).query(column * CELL)
    far: NDArray[np.bool_] = (distance > REACH)[cell]
    return far
