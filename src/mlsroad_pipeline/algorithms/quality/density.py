"""Point density of a file from the numbers of points in the cells of a grid, and its number of places."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

PLACE_CELL = 500.0
"""Side of the cells, metres: points in cells that do not touch lie in different places."""


def count_places(xy: NDArray[np.float64]) -> int:
    """Return the number of places that lie more than `PLACE_CELL` apart.

    Examples
    --------
    >>> count_places(np.array([[0.0, 0.0], [30.0, 0.0], [4000.0, 0.0]]))
    2
    """
    cells = np.unique(np.floor(xy / PLACE_CELL), axis=0)
    if len(cells) < 2:
        return len(cells)
    pairs = cKDTree(cells).query_pairs(1.5, output_type="ndarray")  # neighbours along an axis or a diagonal
    links = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    return int(connected_components(links, directed=False)[0])


def cell_positions(keys: NDArray[np.int64], side: float) -> NDArray[np.float64]:
    """Return the corners of cells from keys with the column in the upper and the row in the lower 32 bits."""
    rows = ((keys + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
    return np.column_stack([(keys - rows) >> 32, rows]) * side


class DensityFigures(NamedTuple):
    """Figures of the point density."""

    # density, median_density: mean and median of the points per square metre in occupied cells
    density: float
    median_density: float
    # Median distance of the points from the centre, over that of the occupied cells; the centre is the mean of the
    # cells, weighted by the squares of their numbers of points. A single scan of a rotating scanner has 0.2 to 0.45, a
    # street surveyed by line scanners 0.5 to 1.
    concentration: float


def density_figures(cells: NDArray[np.int64], counts: NDArray[np.int64], side: float) -> DensityFigures:
    """Return figures of the point density."""
    if not len(cells):
        return DensityFigures(float("nan"), float("nan"), float("nan"))
    weight = counts.astype(np.float64) ** 2
    corners = cell_positions(cells, side)
    corners -= corners.mean(axis=0)  # weighted sums of world coordinates lose digits
    centre = weight @ corners / weight.sum()
    distance = np.hypot(*(corners - centre).T)
    of_cells = float(np.median(distance))
    concentration = _weighted_median(distance, counts) / of_cells if of_cells > 0 else 1.0
    return DensityFigures(float(counts.mean()) / side**2, float(np.median(counts)) / side**2, concentration)


def _weighted_median(values: NDArray[np.float64], counts: NDArray[np.int64]) -> float:
    """Return the median of values that are repeated `counts` times."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(counts[order])
    return float(values[order[np.searchsorted(below, below[-1] / 2)]])
