"""Kernels of the multi-scale voxel features; the columns of their results are those of `voxel_scales`."""

from math import hypot, log2, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.eigen_solver import solve_symmetric
from mlsroad_pipeline.algorithms.geometry.cells import first_window, move_window

N_MOMENTS = 12
"""Columns of moments: number, x, y, z, xx, yy, zz, xy, xz, yz, and sums of intensity ranks and of their squares."""
N_SHAPES = 16
"""Columns of `describe_cells`."""
N_RUNS = 6
"""Columns of `describe_runs`."""
BAND_EDGES = (0.3, 1.0, 2.0, 4.0, 8.0)
"""Heights between the bands of the surroundings, metres."""
N_BANDS = len(BAND_EDGES) + 1
_BATCH = 128
"""Cells whose eigenproblems are solved together."""
_FLOOR = 1e-6
"""Added to standard deviations, metres: ratios are defined for points of one line."""
_MIN_VOXELS = 3
"""Voxels below which shape and orientation are missing."""


@njit(cache=True, nogil=True)
def sum_voxels(
    xyz: NDArray, minimum: NDArray, height: NDArray, ranks: NDArray, owner: NDArray, n_voxels: int
) -> NDArray[np.float64]:
    """Return sums of x, y, z, height and rank, lowest and highest z and highest rank of the points of each voxel.

    Points are read in their order, in which those of a voxel are mostly close together; `ranks` may be empty.
    """
    sums = np.zeros((n_voxels, 8))
    sums[:, 5], sums[:, 6], sums[:, 7] = np.inf, -np.inf, -1.0
    for p in range(len(owner)):
        row, dz = sums[owner[p]], xyz[p, 2] - minimum[2]
        row[0] += xyz[p, 0] - minimum[0]
        row[1] += xyz[p, 1] - minimum[1]
        row[2] += dz
        row[5], row[6] = min(row[5], dz), max(row[6], dz)
        if not np.isnan(height[p]):
            row[3] += height[p]
        if len(ranks) > 0:
            row[4] += ranks[p]
            row[7] = max(row[7], ranks[p])
    return sums


@njit(cache=True, nogil=True)
def describe_voxels(
    sums: NDArray, starts: NDArray, with_ranks: bool, moments: NDArray, heights: NDArray
) -> NDArray[np.float32]:
    """Write the moments of single voxels and their mean heights, and return table columns 0 to 4."""
    table = np.empty((len(sums), 5), np.float32)
    for v in range(len(sums)):
        s, n = sums[v], float(starts[v + 1] - starts[v])
        x, y, z, h, r = s[0] / n, s[1] / n, s[2] / n, s[3] / n, s[4] / n
        m = moments[v]
        m[0], m[1], m[2], m[3] = 1.0, x, y, z
        m[4], m[5], m[6], m[7], m[8], m[9] = x * x, y * y, z * z, x * y, x * z, y * z
        m[10], m[11] = r, r * r
        heights[v] = h
        t = table[v]
        t[0], t[1], t[2] = h, log2(n), s[6] - s[5]
        t[3], t[4] = (r, s[7]) if with_ranks else (np.nan, np.nan)
    return table


@njit(cache=True, nogil=True)
def lowest_and_highest(owner: NDArray, low: NDArray, high: NDArray, base: NDArray, n_groups: int) -> NDArray:
    """Return minimum of `low`, maximum of `high` and minimum of `base` of each group, shape (3, groups)."""
    out = np.empty((3, n_groups))
    out[0], out[1], out[2] = np.inf, -np.inf, np.inf
    for i in range(len(owner)):
        o = owner[i]
        out[0, o] = min(out[0, o], low[i])
        out[1, o] = max(out[1, o], high[i])
        out[2, o] = min(out[2, o], base[i])
    return out


@njit(cache=True, nogil=True)
def _spread_in_plan(n: float, x: float, y: float, xx: float, yy: float, xy: float) -> tuple[float, float]:
    """Return the standard deviations along the two main axes in plan."""
    mx, my = x / n, y / n
    cx, cy, cxy = xx / n - mx * mx, yy / n - my * my, xy / n - mx * my
    root = sqrt((cx - cy) * (cx - cy) + 4.0 * cxy * cxy)
    return sqrt(max((cx + cy + root) / 2.0, 0.0)), sqrt(max((cx + cy - root) / 2.0, 0.0))


@njit(cache=True, nogil=True)
def _emit_moments(s: NDArray, flat: NDArray, size: float, a: NDArray, b: int, row: NDArray, mean: NDArray) -> None:
    """Write covariance (column b of `a`), mean and the features that need no eigenvalues in space."""
    n = s[0]
    x, y, z = s[1] / n, s[2] / n, s[3] / n
    mean[0], mean[1], mean[2] = x, y, z
    zz = s[6] / n - z * z
    a[0, b], a[1, b], a[2, b] = s[4] / n - x * x, s[7] / n - x * y, s[8] / n - x * z
    a[3, b], a[4, b], a[5, b] = s[5] / n - y * y, s[9] / n - y * z, zz
    wide, narrow = _spread_in_plan(n, s[1], s[2], s[4], s[5], s[7])
    row[7], row[8], row[9], row[10] = sqrt(max(zz, 0.0)) / size, wide / size, narrow / size, log2(n)
    r = s[10] / n
    row[11], row[12] = r, sqrt(max(s[11] / n - r * r, 0.0))
    wide, narrow = _spread_in_plan(flat[0], flat[1], flat[2], flat[4], flat[5], flat[7])
    row[13], row[14], row[15] = wide / size, narrow / size, log2(flat[0])


@njit(cache=True, nogil=True)
def _emit_eigen(w: NDArray, normal: NDArray, main: NDArray, b: int, size: float, row: NDArray) -> None:
    s1, s2, s3 = sqrt(w[0, b]) + _FLOOR, sqrt(w[1, b]) + _FLOOR, sqrt(w[2, b]) + _FLOOR
    row[5], row[6] = s1 / size, s3 / size
    if 2.0 ** row[10] > _MIN_VOXELS - 0.5:
        row[0], row[1], row[2] = (s1 - s2) / s1, (s2 - s3) / s1, s3 / s1
        row[3], row[4] = abs(normal[2, b]), abs(main[2, b])
    else:
        row[:5] = np.nan


@njit(cache=True, nogil=True)
def describe_cells(
    keys: NDArray,
    rows: NDArray,
    moments: NDArray,
    size: float,
    out: NDArray,
    means: NDArray,
    first: int,
    last: int,
) -> None:
    """Write shape, orientation, spread, intensity and slice of the 27 cells around each cell (`N_SHAPES` columns)."""
    if first >= last:
        return
    sums, flat = np.empty(N_MOMENTS), np.empty(N_MOMENTS)
    a, w = np.empty((6, _BATCH)), np.empty((3, _BATCH))
    normal, main = np.empty((3, _BATCH)), np.empty((3, _BATCH))
    begin, end = first_window(keys, keys[first], rows, 1)
    for batch in range(first, last, _BATCH):
        n_batch = min(_BATCH, last - batch)
        for b in range(n_batch):
            cell = batch + b
            move_window(keys, keys[cell], rows, 1, begin, end)
            sums[:], flat[:] = 0.0, 0.0
            for j in range(len(rows)):
                level = keys[cell] + rows[j, 2]
                for p in range(begin[j], end[j]):
                    for q in range(N_MOMENTS):
                        sums[q] += moments[p, q]
                    if keys[p] == level:
                        for q in range(N_MOMENTS):
                            flat[q] += moments[p, q]
            _emit_moments(sums, flat, size, a, b, out[cell], means[cell])
        solve_symmetric(a, n_batch, w, normal, main)
        for b in range(n_batch):
            _emit_eigen(w, normal, main, b, size, out[batch + b])


@njit(cache=True, nogil=True)
def describe_runs(index: NDArray, low: NDArray, high: NDArray, out: NDArray) -> None:
    """Write bottom, top, length and fill of each vertical run of cells, and the gaps above and below it.

    A run bridges one empty cell. Gaps are NaN where no other run lies above or below.
    """
    n, start = len(index), 0
    while start < n:
        end = start
        while end + 1 < n and _same_column(index, end + 1, start) and index[end + 1, 2] - index[end, 2] <= 2:
            end += 1
        bottom, top = low[start], high[end]
        fill = (end - start + 1) / (index[end, 2] - index[start, 2] + 1)
        above = low[end + 1] - top if end + 1 < n and _same_column(index, end + 1, start) else np.nan
        below = bottom - high[start - 1] if start > 0 and _same_column(index, start - 1, start) else np.nan
        for i in range(start, end + 1):
            row = out[i]
            row[0], row[1], row[2], row[3], row[4], row[5] = bottom, top, top - bottom, fill, above, below
        start = end + 1


@njit(cache=True, nogil=True)
def _same_column(index: NDArray, i: int, j: int) -> bool:
    return index[i, 0] == index[j, 0] and index[i, 1] == index[j, 1]


@njit(cache=True, nogil=True)
def widen_extremes(keys: NDArray, rows: NDArray, reach: int, extremes: NDArray) -> NDArray:
    """Return the extremes (3, c) of `lowest_and_highest` over the window of each column."""
    out = np.empty_like(extremes)
    if len(keys) == 0:
        return out
    begin, end = first_window(keys, keys[0], rows, reach)
    for i in range(len(keys)):
        move_window(keys, keys[i], rows, reach, begin, end)
        low, high, base = np.inf, -np.inf, np.inf
        for j in range(len(rows)):
            for p in range(begin[j], end[j]):
                low, high, base = min(low, extremes[0, p]), max(high, extremes[1, p]), min(base, extremes[2, p])
        out[0, i], out[1, i], out[2, i] = low, high, base
    return out


@njit(cache=True, nogil=True)
def count_bands(column: NDArray, heights: NDArray, n_columns: int) -> NDArray[np.float64]:
    """Return the number of voxels of each column and height band, shape (columns, bands)."""
    counts = np.zeros((n_columns, N_BANDS))
    for i in range(len(column)):
        band = 0
        for edge in BAND_EDGES:
            band += heights[i] >= edge
        counts[column[i], band] += 1.0
    return counts


@njit(cache=True, nogil=True)
def copy_rows(owner: NDArray, values: NDArray, target: NDArray, table: NDArray, first: int, last: int) -> None:
    """Copy column q of the owner's row of `values` to column ``target[q]`` of the table; -1 is skipped."""
    for i in range(first, last):
        row = values[owner[i]]
        for q in range(len(target)):
            if target[q] >= 0:
                table[i, target[q]] = row[q]


@njit(cache=True, nogil=True)
def write_offsets(
    owner: NDArray, moments: NDArray, means: NDArray, size: float, at: int, table: NDArray, first: int, last: int
) -> None:
    """Write the offsets of each voxel from the mean of its window, vertical and in plan, in cells."""
    for i in range(first, last):
        mean = means[owner[i]]
        table[i, at] = (moments[i, 3] - mean[2]) / size
        table[i, at + 1] = hypot(moments[i, 1] - mean[0], moments[i, 2] - mean[1]) / size


@njit(cache=True, nogil=True)
def write_columns(
    column: NDArray,
    own: NDArray,
    wide: NDArray,
    moments: NDArray,
    heights: NDArray,
    relief: bool,
    at: int,
    table: NDArray,
    first: int,
    last: int,
) -> None:
    """Write distances to top and bottom of own and nine columns, and to the lowest voxel of the nine if `relief`."""
    for i in range(first, last):
        c, h, row = column[i], heights[i], table[i]
        row[at], row[at + 1] = own[1, c] - h, h - own[0, c]
        row[at + 2], row[at + 3] = wide[1, c] - h, h - wide[0, c]
        if relief:
            row[at + 4] = moments[i, 3] - wide[2, c]


@njit(cache=True, nogil=True)
def write_surroundings(
    column: NDArray,
    bands: NDArray,
    top: NDArray,
    heights: NDArray,
    at: int,
    table: NDArray,
    first: int,
    last: int,
) -> None:
    """Write shares of the height bands, top, height relative to it, and number of voxels of the surroundings."""
    for i in range(first, last):
        c, row = column[i], table[i]
        total = 0.0
        for b in range(N_BANDS):
            total += bands[c, b]
        row[at] = bands[c, 0] / total
        upper = max(total - bands[c, 0], 1.0)
        for b in range(1, N_BANDS):
            row[at + b] = bands[c, b] / upper
        row[at + N_BANDS] = top[c]
        row[at + N_BANDS + 1] = heights[i] / max(top[c], 0.5)
        row[at + N_BANDS + 2] = log2(total)
