"""Footprint features: plan view of the upright columns around a supervoxel."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.columns import ColumnRaster

FOOTPRINT_FEATURES = ("footprint_linearity", "footprint_width", "footprint_cover", "footprint_height", "footprint_top")
"""Features of `describe_footprints`, whose names have the suffix ``_<radius>m``."""

CLEARANCE = 1.0
"""Minimum height of a column above the lowest point around it, metres."""


def footprint_feature_names(radius: float) -> tuple[str, ...]:
    """Return the names of the columns of `describe_footprints`."""
    return tuple(f"{name}_{radius:g}m" for name in FOOTPRINT_FEATURES)


@njit(cache=True, nogil=True)
def _count_slices(occupied: NDArray, first: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the number of occupied slices of each column from `first` on, and the top of the highest one."""
    filled, top = np.zeros(occupied.shape, np.float32), np.zeros(occupied.shape, np.float32)
    one = np.uint64(1)
    for row in range(occupied.shape[0]):
        for column in range(occupied.shape[1]):
            bits = occupied[row, column] >> np.uint64(first)
            level = first
            while bits != np.uint64(0):
                level += 1
                if bits & one:
                    filled[row, column] += np.float32(1.0)
                    top[row, column] = level
                bits >>= one
    return filled, top


@njit(cache=True, nogil=True, error_model="numpy")
def _scan(
    centroids: NDArray,
    west: float,
    south: float,
    size: float,
    filled: NDArray,
    top: NDArray,
    radius: float,
    out: NDArray,
) -> None:
    n_rows, n_columns = filled.shape
    reach = int(radius / size) + 1
    limit = (radius / size) ** 2
    for s in range(len(centroids)):
        x, y = (centroids[s, 0] - west) / size - 0.5, (centroids[s, 1] - south) / size - 0.5
        column, row = int(x + 0.5), int(y + 0.5)
        cells, upright, highest = 0, 0, 0.0
        n = sx = sy = sxx = sxy = syy = 0.0
        for r in range(row - reach, row + reach + 1):
            for c in range(column - reach, column + reach + 1):
                dx, dy = c - x, r - y
                if dx * dx + dy * dy > limit:
                    continue
                cells += 1
                if r < 0 or r >= n_rows or c < 0 or c >= n_columns or filled[r, c] == 0.0:
                    continue
                w = np.float64(filled[r, c])
                upright += 1
                highest = max(highest, top[r, c])
                n += w
                sx += w * dx
                sy += w * dy
                sxx += w * dx * dx
                sxy += w * dx * dy
                syy += w * dy * dy
        out[s, 0], out[s, 1] = np.nan, np.nan
        out[s, 2] = upright / cells
        out[s, 3] = n * size / upright if upright else 0.0
        out[s, 4] = highest * size
        if upright < 2:
            continue
        mx, my = sx / n, sy / n
        xx, xy, yy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
        mean, spread = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy * xy)
        narrow = max(mean - spread, 0.0)
        out[s, 0] = 1.0 - narrow / (mean + spread)
        out[s, 1] = np.sqrt(narrow) * size


def describe_footprints(centroids: NDArray[np.float64], raster: ColumnRaster, *, radius: float) -> NDArray[np.float32]:
    """Compute features of the columns above `CLEARANCE` within a radius of each supervoxel.

    The weight of a column is its number of occupied slices above the clearance, independent of ground and scan density.
    """
    filled, top = _count_slices(raster.occupied, round(CLEARANCE / raster.cell_size))
    out = np.empty((len(centroids), len(FOOTPRINT_FEATURES)), np.float32)
    _scan(centroids, raster.west, raster.south, raster.cell_size, filled, top, radius, out)
    return out
