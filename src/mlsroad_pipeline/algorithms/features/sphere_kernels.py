"""Kernels of the multiscale spherical neighbourhoods."""

from __future__ import annotations

from math import asin, log

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.eigen_solver import FAST, solve_symmetric
from mlsroad_pipeline.algorithms.geometry.cell_windows import first_window, move_window

N_GEOMETRY = 18
"""Columns of a scale that need coordinates alone; mean and variance of each attribute follow."""
N_ORIENTED = 15
"""First columns, those that need eigenvectors: missing for fewer than `_LEAST` points."""
_LEAST = 3
_BATCH = 128
"""Neighbourhoods whose eigenproblems are solved together."""
_TINY = 1e-12
"""Least sum of eigenvalues, in squared radii."""


@njit(cache=True, nogil=True)
def average_groups(values: NDArray, order: NDArray, starts: NDArray) -> NDArray[np.float64]:
    """Return the means (groups, m) of the rows of `values`; group j holds ``order[starts[j]:starts[j + 1]]``."""
    means = np.zeros((len(starts) - 1, values.shape[1]))
    for group in range(len(means)):
        for i in range(starts[group], starts[group + 1]):
            for j in range(values.shape[1]):
                means[group, j] += values[order[i], j]
        for j in range(values.shape[1]):
            means[group, j] /= starts[group + 1] - starts[group]
    return means


@njit(cache=True, nogil=True)
def describe_spheres(
    keys: NDArray,
    rows: NDArray,
    reach: int,
    points: NDArray,
    attributes: NDArray,
    places: NDArray,
    queries: NDArray,
    order: NDArray,
    starts: NDArray,
    target: NDArray,
    radius: float,
    table: NDArray,
    at: int,
    first: int,
    last: int,
) -> None:
    """Write the features of the spheres around queries from column `at` on.

    Cell j holds the point ``points[j]`` and the queries ``order[starts[j]:starts[j + 1]]``. `target` has the row of the
    table of each query; -1 is skipped. `places` has the columns of the attributes' means after those of the geometry.
    """
    if first >= last:
        return
    n_sums, size = 10 + 2 * len(places), (2 * reach + 1) ** 3
    x, y, z, inside = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    near = np.empty((max(len(places), 1), size))
    sums, row_of = np.empty((_BATCH, n_sums)), np.empty(_BATCH, np.int64)
    a, w = np.empty((6, _BATCH)), np.empty((3, _BATCH))
    normal, main = np.empty((3, _BATCH)), np.empty((3, _BATCH))
    begin, end = first_window(keys, keys[first], rows, reach)
    b = 0
    for cell in range(first, last):
        n = -1
        for m in range(starts[cell], starts[cell + 1]):
            q = order[m]
            if target[q] < 0:
                continue
            if n < 0:
                move_window(keys, keys[cell], rows, reach, begin, end)
                n = _gather(begin, end, points, attributes, points[cell], 1.0 / radius, x, y, z, near)
            qx, qy = (queries[q, 0] - points[cell, 0]) / radius, (queries[q, 1] - points[cell, 1]) / radius
            qz = (queries[q, 2] - points[cell, 2]) / radius
            _sum_sphere(x, y, z, n, qx, qy, qz, inside, sums[b])
            for k in range(len(places)):
                _sum_attribute(near[k], inside, n, sums[b], 10 + 2 * k)
            row_of[b] = target[q]
            b += 1
            if b == _BATCH:
                _emit_batch(sums, b, row_of, places, a, w, normal, main, table, at)
                b = 0
    _emit_batch(sums, b, row_of, places, a, w, normal, main, table, at)


@njit(cache=True, nogil=True)
def _gather(
    begin: NDArray,
    end: NDArray,
    points: NDArray,
    attributes: NDArray,
    origin: NDArray,
    scale: float,
    x: NDArray,
    y: NDArray,
    z: NDArray,
    near: NDArray,
) -> int:
    """Copy the points of a window, relative to `origin` and in radii, and return their number."""
    n = 0
    for j in range(len(begin)):
        for p in range(begin[j], end[j]):
            x[n] = (points[p, 0] - origin[0]) * scale
            y[n] = (points[p, 1] - origin[1]) * scale
            z[n] = (points[p, 2] - origin[2]) * scale
            for k in range(attributes.shape[1]):
                near[k, n] = attributes[p, k]
            n += 1
    return n


@njit(cache=True, nogil=True, fastmath=FAST)
def _sum_sphere(
    x: NDArray, y: NDArray, z: NDArray, n: int, qx: float, qy: float, qz: float, inside: NDArray, sums: NDArray
) -> None:
    """Write number and moments of the points within 1 of a query, relative to it."""
    count = sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = 0.0
    for i in range(n):
        u, v, w = x[i] - qx, y[i] - qy, z[i] - qz
        hit = 1.0 if u * u + v * v + w * w <= 1.0 else 0.0
        inside[i] = hit
        u, v, w = u * hit, v * hit, w * hit
        count += hit
        sx += u
        sy += v
        sz += w
        sxx += u * u
        sxy += u * v
        sxz += u * w
        syy += v * v
        syz += v * w
        szz += w * w
    sums[0], sums[1], sums[2], sums[3] = count, sx, sy, sz
    sums[4], sums[5], sums[6], sums[7], sums[8], sums[9] = sxx, sxy, sxz, syy, syz, szz


@njit(cache=True, nogil=True, fastmath=FAST)
def _sum_attribute(values: NDArray, inside: NDArray, n: int, sums: NDArray, at: int) -> None:
    total = squares = 0.0
    for i in range(n):
        value = values[i] * inside[i]
        total += value
        squares += value * value
    sums[at], sums[at + 1] = total, squares


@njit(cache=True, nogil=True)
def _emit_batch(
    sums: NDArray,
    n_batch: int,
    row_of: NDArray,
    places: NDArray,
    a: NDArray,
    w: NDArray,
    normal: NDArray,
    main: NDArray,
    table: NDArray,
    at: int,
) -> None:
    for b in range(n_batch):
        s = sums[b]
        n = s[0]
        mx, my, mz = s[1] / n, s[2] / n, s[3] / n
        a[0, b], a[1, b], a[2, b] = s[4] / n - mx * mx, s[5] / n - mx * my, s[6] / n - mx * mz
        a[3, b], a[4, b], a[5, b] = s[7] / n - my * my, s[8] / n - my * mz, s[9] / n - mz * mz
    solve_symmetric(a, n_batch, w, normal, main)
    for b in range(n_batch):
        s, row = sums[b], table[row_of[b]]
        n = s[0]
        if n < _LEAST:
            row[at : at + N_ORIENTED] = np.nan
        else:
            _emit_shape(w[0, b], w[1, b], w[2, b], normal[2, b], main[2, b], row, at)
            _emit_moments(s[1] / n, s[2] / n, s[3] / n, w[:, b], normal[:, b], main[:, b], row, at + 9)
        row[at + 15], row[at + 16], row[at + 17] = s[3] / n, s[9] / n, n
        for k in range(len(places)):
            mean = s[10 + 2 * k] / n
            column = at + N_GEOMETRY + places[k]
            row[column], row[column + 1] = mean, max(s[11 + 2 * k] / n - mean * mean, 0.0)


@njit(cache=True, nogil=True)
def _emit_shape(w1: float, w2: float, w3: float, normal_z: float, main_z: float, row: NDArray, at: int) -> None:
    """Write the nine features of eigenvalues and directions; verticality is the angle from the horizontal plane."""
    total = max(w1 + w2 + w3, _TINY)
    entropy = 0.0
    for value in (w1, w2, w3):
        share = value / total
        entropy -= share * log(share) if share > 0.0 else 0.0
    largest = max(w1, _TINY)
    row[at], row[at + 1], row[at + 2] = total, (w1 * w2 * w3) ** (1.0 / 3.0), entropy
    row[at + 3], row[at + 4], row[at + 5] = (w1 - w2) / largest, (w2 - w3) / largest, w3 / largest
    row[at + 6] = w3 / total
    row[at + 7], row[at + 8] = asin(min(abs(main_z), 1.0)), asin(min(abs(normal_z), 1.0))


@njit(cache=True, nogil=True)
def _emit_moments(
    mx: float, my: float, mz: float, w: NDArray, normal: NDArray, main: NDArray, row: NDArray, at: int
) -> None:
    """Write the absolute moments of order 1 and 2 about the query along the three eigenvectors."""
    ex = normal[1] * main[2] - normal[2] * main[1]
    ey = normal[2] * main[0] - normal[0] * main[2]
    ez = normal[0] * main[1] - normal[1] * main[0]
    along = (
        abs(mx * main[0] + my * main[1] + mz * main[2]),
        abs(mx * ex + my * ey + mz * ez),
        abs(mx * normal[0] + my * normal[1] + mz * normal[2]),
    )
    for i in range(3):
        row[at + i] = along[i]
        row[at + 3 + i] = w[i] + along[i] * along[i]
