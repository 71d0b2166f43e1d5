"""Figures of the point density of a file, from the numbers of points in the cells of a grid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.quality.places import cell_positions


class DensityFigures(NamedTuple):
    """Figures of the point density."""

    density: float  # Mean and median of the points per square metre in occupied cells
    median_density: float  # Mean and median of the points per square metre in occupied cells
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
