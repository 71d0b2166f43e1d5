"""Features of the columns around the centroid of a supervoxel: occupied height slices and footprints."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.cells import bounding_box

COLUMN_FEATURES = (
    "column_extent",
    "height_above_column_bottom",
    "height_below_column_top",
    "height_above_lowest",
    "gap_below",
    "gap_above",
    "run_extent",
    "column_fill",
    "cover_near",
    "cover_far",
)
"""Columns of `describe_columns`."""

SLICES = 64
_MAX_RASTER = 2**26


@dataclass(frozen=True)
class ColumnRaster:
    """Raster of columns of points."""

    # low, high: lowest and highest z of each cell, metres; infinite for empty cells
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    lowest: NDArray[np.float64]  # Lowest z within the relief radius
    base: NDArray[np.int64]  # Slice of bit 0 of `occupied`, that of `lowest`
    # Bit b is set if slice ``base + b`` contains a point; the last bit includes all higher slices
    occupied: NDArray[np.uint64]
    # west, south, bottom: corner of the first cell and height of the first slice, metres
    west: float
    south: float
    bottom: float
    cell_size: float  # Edge of a cell and height of a slice, metres


@njit(cache=True, nogil=True)
def _extremes(
    xyz: NDArray, west: float, south: float, cell_size: float, shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low, high = np.full(shape, np.inf), np.full(shape, -np.inf)
    inverse = 1.0 / cell_size
    for i in range(len(xyz)):
        row, column = np.int64((xyz[i, 1] - south) * inverse), np.int64((xyz[i, 0] - west) * inverse)
        z = np.float64(xyz[i, 2])
        low[row, column] = min(low[row, column], z)
        high[row, column] = max(high[row, column], z)
    return low, high


@njit(cache=True, nogil=True)
def _occupy(
    xyz: NDArray, west: float, south: float, bottom: float, cell_size: float, base: NDArray
) -> NDArray[np.uint64]:
    occupied = np.zeros(base.shape, np.uint64)
    inverse = 1.0 / cell_size
    for i in range(len(xyz)):
        row, column = np.int64((xyz[i, 1] - south) * inverse), np.int64((xyz[i, 0] - west) * inverse)
        level = np.int64((xyz[i, 2] - bottom) * inverse) - base[row, column]
        occupied[row, column] |= np.uint64(1) << np.uint64(min(max(level, 0), SLICES - 1))
    return occupied


def build_columns(xyz: NDArray[np.floating], *, cell_size: float, relief_radius: float) -> ColumnRaster:
    """Sort points into columns."""
    (west, south, bottom), (east, north, _) = bounding_box(xyz).tolist()
    shape = (int((north - south) / cell_size) + 2, int((east - west) / cell_size) + 2)
    if shape[0] * shape[1] > _MAX_RASTER:
        extent = f"{east - west:.1f} m by {north - south:.1f} m"
        raise DataError(f"an extent of {extent} is too large for columns of {cell_size} m: remove outliers")
    low, high = _extremes(xyz, west, south, cell_size, shape)
    reach = max(1, round(relief_radius / cell_size))
    lowest = minimum_filter(low, size=2 * reach + 1, mode="nearest")
    base = np.where(np.isfinite(lowest), (lowest - bottom) / cell_size, 0).astype(np.int64)
    occupied = _occupy(xyz, west, south, bottom, cell_size, base)
    return ColumnRaster(low, high, lowest, base, occupied, west, south, bottom, cell_size)


@njit(cache=True, nogil=True)
def _shifted(bits: np.uint64, levels: int) -> np.uint64:
    """Shift the slices of a column up by `levels` (down if negative); bits beyond an end are merged into it."""
    if levels == 0 or bits == np.uint64(0):
        return bits
    one = np.uint64(1)
    if abs(levels) >= SLICES:
        return one << np.uint64(SLICES - 1) if levels > 0 else one
    if levels > 0:
        moved = bits << np.uint64(levels)
        lost = bits >> np.uint64(SLICES - levels)
        return moved | (one << np.uint64(SLICES - 1)) if lost != np.uint64(0) else moved
    moved = bits >> np.uint64(-levels)
    lost = bits & ((one << np.uint64(-levels)) - one)
    return moved | one if lost != np.uint64(0) else moved


@njit(cache=True, nogil=True)
def _cover(occupied: NDArray, base: NDArray, row: int, column: int, reach: int, level: int) -> float:
    """Return the fraction of surrounding cells that are occupied at a level or an adjacent one."""
    hits, cells = 0, 0
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            cells += 1
            if 0 <= r < base.shape[0] and 0 <= c < base.shape[1] and occupied[r, c] != np.uint64(0):
                bits = _shifted(occupied[r, c], base[r, c] - base[row, column])
                low = max(level - 1, 0)
                hits += ((bits >> np.uint64(low)) & np.uint64(7 if level > 0 else 3)) != np.uint64(0)
    return hits / cells


@njit(cache=True, nogil=True)
def _scan(
    centroids: NDArray,
    west: float,
    south: float,
    bottom: float,
    size: float,
    base: NDArray,
    occupied: NDArray,
    out: NDArray,
) -> None:
    """Write the features from ``gap_below`` on."""
    one = np.uint64(1)
    n_rows, n_columns = base.shape
    near, far = np.int64(2), np.int64(5)  # each literal would compile a version of its own
    for s in range(len(centroids)):
        row, column = int((centroids[s, 1] - south) / size), int((centroids[s, 0] - west) / size)
        level = min(max(np.int64((centroids[s, 2] - bottom) / size) - base[row, column], 0), SLICES - 1)
        bits = one << np.uint64(level)  # the slice of a centroid may be empty
        for r in range(max(row - 1, 0), min(row + 2, n_rows)):
            for c in range(max(column - 1, 0), min(column + 2, n_columns)):
                bits |= _shifted(occupied[r, c], base[r, c] - base[row, column])
        below, above = level, level
        while below > 0 and (bits >> np.uint64(below - 1)) & one:
            below -= 1
        while above < SLICES - 1 and (bits >> np.uint64(above + 1)) & one:
            above += 1
        first, last, filled = SLICES, 0, 0
        under, over = -1, SLICES
        for level_at in range(SLICES):
            if (bits >> np.uint64(level_at)) & one:
                first, last, filled = min(first, level_at), level_at, filled + 1
                if level_at < below:
                    under = level_at
                if level_at > above:
                    over = min(over, level_at)
        out[s, 0] = (below - 1 - under) * size
        out[s, 1] = (over - above - 1) * size if over < SLICES else 0.0
        out[s, 2] = (above - below + 1) * size
        out[s, 3] = filled / (last - first + 1)
        out[s, 4] = _cover(occupied, base, row, column, near, level)
        out[s, 5] = _cover(occupied, base, row, column, far, level)


def describe_columns(centroids: NDArray[np.float64], raster: ColumnRaster) -> NDArray[np.float32]:
    """Compute the column features of supervoxels.

    The column of a supervoxel is the block of 3 x 3 cells around its centroid. A ground classification is not required:
    the lowest point within the relief radius substitutes the ground.
    """
    size = raster.cell_size
    at = (
        ((centroids[:, 1] - raster.south) / size).astype(np.int64),
        ((centroids[:, 0] - raster.west) / size).astype(np.int64),
    )
    column_low = minimum_filter(raster.low, size=3, mode="nearest")[at]
    column_high = maximum_filter(raster.high, size=3, mode="nearest")[at]
    z = centroids[:, 2]
    out = np.empty((len(centroids), len(COLUMN_FEATURES)), np.float32)
    out[:, 0] = column_high - column_low
    out[:, 1] = z - column_low
    out[:, 2] = column_high - z
    out[:, 3] = z - raster.lowest[at]
    _scan(centroids, raster.west, raster.south, raster.bottom, size, raster.base, raster.occupied, out[:, 4:])
    return out


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
def _scan_discs(
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
    _scan_discs(centroids, raster.west, raster.south, raster.cell_size, filled, top, radius, out)
    return out
