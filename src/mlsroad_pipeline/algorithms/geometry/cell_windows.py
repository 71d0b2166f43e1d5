"""The occupied cells around a cell, found by moving on from the cell before: what neighbourhood kernels share."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def first_window(keys: NDArray, key: int, rows: NDArray, reach: int) -> tuple[NDArray, NDArray]:
    """Return each row's range of cells within reach of a cell, still empty: `move_window` fills it."""
    begin, end = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
    for j in range(len(rows)):
        begin[j] = np.searchsorted(keys, key + rows[j, 2] - reach)
        end[j] = begin[j]
    return begin, end


@njit(cache=True, nogil=True)
def move_window(keys: NDArray, key: int, rows: NDArray, reach: int, begin: NDArray, end: NDArray) -> None:
    """Move each row's range of cells on to those within reach of a cell; cells must come in ascending order."""
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
    """Return how many points lie in the ranges of cells, at least 1."""
    bound = 1
    for j in range(len(begin)):
        bound += starts[end[j]] - starts[begin[j]]
    return bound
