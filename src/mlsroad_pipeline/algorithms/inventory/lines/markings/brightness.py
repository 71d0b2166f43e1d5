"""Cells of the road, their brightness against the road around them, and the scanner passes of its points."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.geometry.cells import CellGrid, build_cell_grids
from mlsroad_pipeline.algorithms.geometry.sorting import lower_bound, median_of, rank_integers
from mlsroad_pipeline.algorithms.inventory.objects.sightings import ROUTE, SCANNER, SECOND, SOURCE, time_passes

FILE = "file"
"""Column of a scene: number of the file."""

SCANNER_BITS = 20
"""Bits of the number of a scanner pass that hold the scanner; those above hold the pass."""

_CELL = 0.5  # metres
_SHARED = 0.1  # share of the cells from which two sources see the same place


def scanner_pass_of(scene: PointCloud) -> NDArray[np.int64]:
    """Return a number for the scanner and pass of each point of a scene."""
    visit = time_passes(scene[SECOND]) if SECOND in scene else np.zeros(len(scene), dtype=np.int64)
    if SCANNER in scene and (scene[SCANNER] != scene[SCANNER][:1]).any():
        route = scene[ROUTE].astype(np.int64) if ROUTE in scene else 0
        return (visit << 2 * SCANNER_BITS) + (route << SCANNER_BITS) + scene[SCANNER].astype(np.int64)
    number = np.zeros(len(scene), dtype=np.int64)
    for name in (ROUTE, SOURCE, FILE):
        if name in scene:
            values, rank = rank_integers(scene[name])
            number = number * len(values) + rank
    group = _of_one_place(scene.xyz, rank_integers(number)[1])
    return (visit << 2 * SCANNER_BITS) + (group << SCANNER_BITS)


def _of_one_place(xyz: NDArray[np.floating], source: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the group of each point's source: a source joins the first group whose members it does not overlap."""
    n_sources = int(source.max(initial=0)) + 1
    if n_sources == 1:
        return np.zeros(len(source), dtype=np.int64)
    place = np.floor((xyz[:, :2] - xyz[:, :2].min(axis=0)) / _CELL).astype(np.int64)
    cell = rank_integers(place[:, 0] * (int(place[:, 1].max()) + 1) + place[:, 1])[1]
    pairs = np.unique(cell.astype(np.int64) * n_sources + source)
    seen_by = coo_array((np.ones(len(pairs)), (pairs // n_sources, pairs % n_sources))).tocsr()
    shared = (seen_by.T @ seen_by).toarray()
    overlaps = shared > _SHARED * np.minimum(shared.diagonal()[:, None], shared.diagonal())
    group = np.zeros(n_sources, dtype=np.int64)
    for own in range(1, n_sources):
        taken = set(group[:own][overlaps[own, :own]].tolist())
        group[own] = next(k for k in range(own + 1) if k not in taken)
    return group[source]


CELL = 0.1
"""Edge of a cell, metres: the width of a narrow line."""

LOWEST, HIGHEST = -3.0, 12.0
"""Bounds of the brightness, standard deviations."""

_LEVELS = 128  # of intensity, equally frequent
_TREND, _TREND_REACH, _TREND_LEAST = 0.6, 1, 6  # edge of blocks, metres; blocks on either side; cells
_NOISE, _NOISE_REACH, _NOISE_LEAST = 1.2, 2, 20
_RANKS = (0.3, 0.6)  # the first is road, also where half of the cells are paint
_NOISE_FACTOR = 2.0  # of the noise by the differences within cells: few bright points have no normal distribution
_ODD = 1.5
_SATURATED = 30.0
_NORMAL = (0.7777, 0.5244)  # distance of these quantiles, and of the first from the median, in standard deviations


X, Y, Z, LEVEL, BRIGHTNESS, DEVIATION, CORE, BASE = range(8)
"""Columns of the cells; `BASE` is the median of the levels within 3 m."""


def road_cells(
    xyz: NDArray[np.floating], intensity: NDArray[np.floating], core: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the cells of the road with points of one scanner, and their brightness."""
    if len(xyz) == 0:
        return np.zeros((0, 8))
    points = np.column_stack([xyz, intensity, core])
    grid = _flat_grid(points, CELL, 1)
    cells = _cell_means(points, grid.order, grid.starts)
    low, high = np.quantile(cells[:, 3], _RANKS)
    # Where most cells have one value, as of 0, quantiles do not show the noise.
    noise = _NOISE_FACTOR * _noise(points, cells, grid.order, grid.starts) if low == high else 0.0
    trend, _ = _around(cells, noise, _TREND, _TREND_REACH, _TREND_LEAST)
    known = np.isfinite(trend)
    if not known.any():
        return np.zeros((0, 8))
    cells, trend = cells[known], trend[known]
    median, deviation = _around(
        np.column_stack([cells[:, :3], cells[:, 3] - trend]), noise, _NOISE, _NOISE_REACH, _NOISE_LEAST
    )
    brightness = np.clip((cells[:, 3] - trend - median) / deviation, LOWEST, HIGHEST)
    # An intensity far above paint, as of a stud, counts no more than bright paint.
    level = np.minimum(cells[:, 3], trend + median + _SATURATED * deviation)
    base, _ = _around(cells, noise, _NOISE, _NOISE_REACH, _NOISE_LEAST)
    table = np.column_stack([cells[:, :3], level, brightness, deviation, cells[:, 4], base])
    return table[np.isfinite(median) & np.isfinite(base)]


def joined_cells(tables: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the cells of the scanners of one pass as one table.

    Scanners, ranges and angles have other intensities: levels become standard deviations of the road around.
    """
    if len(tables) == 1:
        return tables[0]
    cells = np.concatenate(tables)
    cells[:, LEVEL] = (cells[:, LEVEL] - cells[:, BASE]) / cells[:, DEVIATION]
    cells[:, DEVIATION] = 1.0
    return cells


def _flat_grid(xyz: NDArray[np.float64], size: float, margin: int) -> CellGrid:
    flat = xyz[:, :3].copy()
    flat[:, 2] = 0.0
    (grid,) = build_cell_grids(flat, cell_size=size, margin=margin)
    return grid


def _around(
    cells: NDArray[np.float64], noise: float, size: float, reach: int, least: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return median and deviation of the values around each cell, bilinear between the middles of blocks."""
    values = cells[:, 3]
    blocks = _flat_grid(cells, size, reach + 1)
    levels = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _LEVELS + 1), method="lower"))
    rank = (np.searchsorted(levels, values, side="right") - 1).astype(np.int64)
    counts = _counts(rank, blocks.order, blocks.starts, len(levels))
    table = _statistics(counts, blocks.keys, blocks.shape[0], levels, reach, least, noise, *_RANKS, *_NORMAL)
    return _between(cells, blocks.keys, *blocks.shape[:2], blocks.minimum, blocks.margin, size, *table)


@njit(cache=True, nogil=True)
def _cell_means(points: NDArray, order: NDArray, starts: NDArray) -> NDArray[np.float64]:
    means = np.zeros((len(starts) - 1, points.shape[1]))
    for cell in range(len(means)):
        for i in range(starts[cell], starts[cell + 1]):
            for axis in range(points.shape[1]):
                means[cell, axis] += points[order[i], axis]
        for axis in range(points.shape[1]):
            means[cell, axis] /= starts[cell + 1] - starts[cell]
    return means


@njit(cache=True, nogil=True)
def _noise(points: NDArray, cells: NDArray, order: NDArray, starts: NDArray) -> float:
    """Return the standard error of the mean intensity of a cell from the differences within cells."""
    total = 0.0
    for cell in range(len(cells)):
        for i in range(starts[cell], starts[cell + 1]):
            total += (points[order[i], 3] - cells[cell, 3]) ** 2
    degrees = len(points) - len(cells)
    return float(np.sqrt(total / degrees * len(cells) / len(points))) if degrees else 0.0


@njit(cache=True, nogil=True)
def _counts(rank: NDArray, order: NDArray, starts: NDArray, n_levels: int) -> NDArray[np.int32]:
    counts = np.zeros((len(starts) - 1, n_levels), np.int32)
    for block in range(len(counts)):
        for i in range(starts[block], starts[block + 1]):
            counts[block, rank[order[i]]] += 1
    return counts


@njit(cache=True, nogil=True)
def _quantile(cumulative: NDArray, levels: NDArray, share: float) -> float:
    """Return a quantile, linear within its level: levels can be wide steps of whole numbers."""
    wanted = share * cumulative[-1]
    k = lower_bound(cumulative, wanted)
    before = cumulative[k - 1] if k > 0 else 0.0
    part = (wanted - before) / max(cumulative[k] - before, 1.0)
    low = levels[k]
    high = levels[k + 1] if k + 1 < len(levels) else low
    return low + (part - 0.5) * (high - low)


@njit(cache=True, nogil=True)
def _statistics(
    counts: NDArray, keys: NDArray, nx: int, levels: NDArray, reach: int, least: int, noise: float, first: float,
    second: float, span: float, rest: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Return median and deviation of the values in the blocks around each block, NaN where there are too few."""
    median, deviation = np.full(len(keys), np.nan), np.full(len(keys), np.nan)
    cumulative = np.empty(counts.shape[1])
    least_deviation = max((levels[-1] - levels[0]) * 1e-3, 1e-9)
    for block in range(len(keys)):
        for k in range(len(cumulative)):
            cumulative[k] = 0.0
        for dy in range(-reach, reach + 1):
            a = lower_bound(keys, keys[block] + dy * nx - reach)
            b = lower_bound(keys, keys[block] + dy * nx + reach + 1)
            for other in range(a, b):
                for k in range(len(cumulative)):
                    cumulative[k] += counts[other, k]
        for k in range(1, len(cumulative)):
            cumulative[k] += cumulative[k - 1]
        if cumulative[-1] >= least:
            median[block] = _quantile(cumulative, levels, first)
            deviation[block] = (_quantile(cumulative, levels, second) - median[block]) / span
    # Paint widens the distribution of a place, and patches of one intensity narrow it.
    known, n_known = np.empty(len(keys)), 0
    for block in range(len(keys)):
        if not np.isnan(deviation[block]):
            known[n_known] = deviation[block]
            n_known += 1
    usual = max(median_of(known, n_known), least_deviation, noise) if n_known else np.nan
    for block in range(len(keys)):
        if not np.isnan(deviation[block]):
            deviation[block] = min(max(deviation[block], usual / _ODD), usual * _ODD)
        median[block] += rest * deviation[block]
    return median, deviation


@njit(cache=True, nogil=True)
def _between(
    cells: NDArray, keys: NDArray, nx: int, ny: int, minimum: NDArray, margin: int, size: float, first: NDArray,
    second: NDArray,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    a, b = np.full(len(cells), np.nan), np.full(len(cells), np.nan)
    for i in range(len(cells)):
        x, y = (cells[i, 0] - minimum[0]) / size - 0.5, (cells[i, 1] - minimum[1]) / size - 0.5
        ix, iy = int(np.floor(x)), int(np.floor(y))
        fx, fy = x - ix, y - iy
        total, sum_a, sum_b = 0.0, 0.0, 0.0
        for dy in range(2):
            for dx in range(2):
                key = (margin * ny + iy + dy + margin) * nx + ix + dx + margin
                k = lower_bound(keys, key)
                if k < len(keys) and keys[k] == key and not np.isnan(first[k]):
                    w = (fx if dx else 1.0 - fx) * (fy if dy else 1.0 - fy) + 1e-6
                    total, sum_a, sum_b = total + w, sum_a + w * first[k], sum_b + w * second[k]
        if total > 0:
            a[i], b[i] = sum_a / total, sum_b / total
    return a, b
