"""Thinning of a cloud to one point per cell of a grid."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_START = 1 << 12  # slots of the smallest hash table
_MIX = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio


def first_in_cells(xyz: NDArray[np.floating], cell_size: float) -> NDArray[np.int64]:
    """Return the first point of each occupied cell of a grid at the zero of the coordinates.

    Parameters
    ----------
    xyz : ndarray of float32 or float64, shape (n, 3)
        Coordinates, metres; finite, of at most 2**31 cells along an axis. Cells are computed in their precision.
    cell_size : float
        Edge of a cell, metres.

    Returns
    -------
    ndarray of int64, shape (m,)
        Rows of the points, ascending.
    """
    return _first_in_cells(np.ascontiguousarray(xyz), xyz.dtype.type(cell_size))


@njit(cache=True, nogil=True)
def _first_in_cells(xyz: NDArray[np.floating], size: float) -> NDArray[np.int64]:
    kept = np.empty(len(xyz), np.int64)
    cells = np.empty((len(xyz), 3), np.int32)  # of the kept points
    table = np.full(_START, -1, np.int32)  # numbers of kept points, by the hash of their cell
    n = 0
    for i in range(len(xyz)):
        x, y, z = (
            np.int32(np.floor(xyz[i, 0] / size)),
            np.int32(np.floor(xyz[i, 1] / size)),
            np.int32(np.floor(xyz[i, 2] / size)),
        )
        slot = _slot(table, cells, x, y, z)
        if table[slot] >= 0:
            continue
        table[slot], kept[n], cells[n, 0], cells[n, 1], cells[n, 2] = n, i, x, y, z
        n += 1
        if 2 * n > len(table):
            table = np.full(2 * len(table), -1, np.int32)
            for k in range(n):
                table[_slot(table, cells, cells[k, 0], cells[k, 1], cells[k, 2])] = k
    return kept[:n].copy()


@njit(cache=True, nogil=True)
def _slot(table: NDArray[np.int32], cells: NDArray[np.int32], x: np.int32, y: np.int32, z: np.int32) -> int:
    """Return the slot of a cell, or the free one where it belongs."""
    mixed = ((np.uint64(x) * _MIX + np.uint64(y)) * _MIX + np.uint64(z)) * _MIX
    slot = np.int64(mixed >> np.uint64(33)) & (len(table) - 1)
    while table[slot] >= 0:
        own = table[slot]
        if cells[own, 0] == x and cells[own, 1] == y and cells[own, 2] == z:
            break
        slot = (slot + 1) & (len(table) - 1)
    return slot
