"""Sliding windows of occupied cells around a cell, for neighbourhood kernels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def first_window(keys: NDArray, key: int, rows: NDArray, reach: int) -> tuple[NDArray, NDArray]:
    """Return empty ranges of cells, one per row, at the lower limit of the reach; `move_window` extends them."""
    begin, end = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
    for j in range(len(rows)):
        begin[j] = np.searchsorted(keys, key + rows[j, 2] - reach)
        end[j] = begin[j]
    return begin, end


@njit(cache=True, nogil=True)
def move_window(keys: NDArray, key: int, rows: NDArray, reach: int, begin: NDArray, end: NDArray) -> None:
    """Advance the range of cells of each row to those within reach of a cell; calls must be in ascending order."""
    n = len(keys)
    for j in range(len(rows)):
        low = key + rows[j, 2] - reach
        b, e = begin[j], end[j]
        while b < n and keys[b] < low:
            b += 1
        e = max(e, b)
        while e < n and keys[e] <= low + 2 * reach:
            e += 1
        begin[j], end[j] = b, e


@njit(cache=True, nogil=True)
def most_near(starts: NDArray, begin: NDArray, end: NDArray) -> int:
    """Return an upper bound, at least 1, of the number of points in the ranges of cells."""
    bound = 1
    for j in range(len(begin)):
        bound += starts[end[j]] - starts[begin[j]]
    return bound
