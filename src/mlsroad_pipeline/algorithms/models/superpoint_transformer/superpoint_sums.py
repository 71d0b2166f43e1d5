"""Compiled sums over the points of superpoints, in the order of the points and in float64."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def _sum_columns(
    row: NDArray[np.int64], columns: NDArray[np.floating], n: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the sums and numbers of the finite values of each group and column."""
    sums = np.zeros((n, columns.shape[1]))
    counts = np.zeros((n, columns.shape[1]), np.int64)
    for i in range(len(row)):
        for k in range(columns.shape[1]):
            value = np.float64(columns[i, k])
            if np.isfinite(value):
                sums[row[i], k] += value
                counts[row[i], k] += 1
    return sums, counts


def means(row: NDArray[np.integer], columns: NDArray, n: int) -> NDArray[np.float64]:
    """Return the means of columns per group."""
    kind = np.float32 if columns.dtype == np.float32 else np.float64
    sums, counts = _sum_columns(row.astype(np.int64, copy=False), np.ascontiguousarray(columns, kind), n)
    with np.errstate(invalid="ignore"):
        return sums / counts


@njit(cache=True, nogil=True)
def sum_products(
    owner: NDArray[np.int64], places: NDArray[np.float64], centroid: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return sums of products of coordinates from the centroid, and the largest distance from it, per superpoint."""
    products, radius = np.zeros((len(centroid), 3, 3)), np.zeros(len(centroid))
    offset = np.empty(3)
    for i in range(len(owner)):
        o = owner[i]
        for a in range(3):
            offset[a] = places[i, a] - centroid[o, a]
            for b in range(a + 1):
                products[o, a, b] += offset[a] * offset[b]
        squared = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
        radius[o] = max(radius[o], squared)
    for a in range(3):
        for b in range(a):
            products[:, b, a] = products[:, a, b]
    return products, np.sqrt(radius)


@njit(cache=True, nogil=True)
def extremes(
    owner: NDArray[np.int64], values: NDArray[np.float64], n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest finite value of each superpoint, NaN without one."""
    low, high = np.full(n, np.nan), np.full(n, np.nan)
    for i in range(len(owner)):
        o = owner[i]
        if np.isfinite(values[i]):
            if not low[o] <= values[i]:
                low[o] = values[i]
            if not high[o] >= values[i]:
                high[o] = values[i]
    return low, high
