"""Thinning of a cloud to one point per cell of a grid."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_START = 1 << 12  # slots of the smallest hash table
_MIX = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio


def first_in_cells(xyz: NDArray[np.floating], cell_size: float) -> NDArray[np.int64]:
    """Return the first point of each occupied cell of a grid at the zero of the coordinates."""
    return _first_in_cells(np.ascontiguousarray(xyz), xyz.dtype.type(cell_size))


@njit(cache=True, nogil=True)
def _first_in_cells(xyz: NDArray[np.floating], size: float) -> NDArray[np.int64]:
    """Mark cells in bricks of 4 x 4 x 4, one bit each; a hash table has the bricks."""
    kept, n_kept = np.empty(len(xyz), np.int64), 0
    bricks, marks = np.empty((_START, 3), np.int32), np.zeros(_START, np.uint64)
    table = np.full(2 * _START, -1, np.int32)
    n_bricks, own, last = 0, 0, np.full(3, -(2**31))
    for i in range(len(xyz)):
        x = np.int32(np.floor(xyz[i, 0] / size))
        y = np.int32(np.floor(xyz[i, 1] / size))
        z = np.int32(np.floor(xyz[i, 2] / size))
        if x >> 2 != last[0] or y >> 2 != last[1] or z >> 2 != last[2]:  # successive points are mostly of one brick
            last[0], last[1], last[2] = x >> 2, y >> 2, z >> 2
            slot = _slot(table, bricks, last[0], last[1], last[2])
            if table[slot] < 0:
                table[slot] = n_bricks
                bricks[n_bricks, 0], bricks[n_bricks, 1], bricks[n_bricks, 2] = last[0], last[1], last[2]
                n_bricks += 1
            own = table[slot]
            if n_bricks == len(marks):
                table, bricks, marks = _grown(bricks, marks)
        bit = np.uint64(1) << np.uint64((x & 3) * 16 + (y & 3) * 4 + (z & 3))
        if not marks[own] & bit:
            marks[own] |= bit
            kept[n_kept] = i
            n_kept += 1
    return kept[:n_kept].copy()


@njit(cache=True, nogil=True)
def _slot(table: NDArray[np.int32], bricks: NDArray[np.int32], x: int, y: int, z: int) -> np.int64:
    """Return the slot of a brick, or the free one where it belongs."""
    mixed = ((np.uint64(x) * _MIX + np.uint64(y)) * _MIX + np.uint64(z)) * _MIX
    slot = np.int64(mixed >> np.uint64(33)) & (len(table) - 1)
    while table[slot] >= 0:
        own = table[slot]
        if bricks[own, 0] == x and bricks[own, 1] == y and bricks[own, 2] == z:
            break
        slot = (slot + 1) & (len(table) - 1)
    return slot


@njit(cache=True, nogil=True)
def _grown(
    bricks: NDArray[np.int32], marks: NDArray[np.uint64]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint64]]:
    """Return table, bricks and marks with room for twice as many bricks."""
    n = len(marks)
    more, more_marks = np.empty((2 * n, 3), np.int32), np.zeros(2 * n, np.uint64)
    table = np.full(4 * n, -1, np.int32)
    for k in range(n):
        more_marks[k] = marks[k]
        for axis in range(3):
            more[k, axis] = bricks[k, axis]
        table[_slot(table, more, np.int64(more[k, 0]), np.int64(more[k, 1]), np.int64(more[k, 2]))] = k
    return table, more, more_marks
