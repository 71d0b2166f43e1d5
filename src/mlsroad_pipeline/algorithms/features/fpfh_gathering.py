"""Candidate neighbours of the points of a cell, for the kernels of the fast point feature histograms."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.eigen_solver import FAST

_ZERO = np.float32(0.0)


@njit(cache=True, nogil=True, fastmath=FAST)
def gather(
    local: NDArray,
    starts: NDArray,
    keys: NDArray,
    cell: int,
    rows: NDArray,
    begin: NDArray,
    end: NDArray,
    size: float,
    squared: float,
    near: NDArray,
    source: NDArray,
) -> tuple[int, int]:
    """Copy the candidate neighbours of a cell; return their number and the start of the points of the cell itself."""
    n_near, own = 0, 0
    half = np.float32(0.5 * size)
    near_x, near_y, near_z = near[0], near[1], near[2]
    for j in range(len(rows)):
        shift_y, shift_z = np.float32(rows[j, 0] * size), np.float32(rows[j, 1] * size)
        for other in range(begin[j], end[j]):
            shift_x = np.float32((keys[other] - keys[cell] - rows[j, 2]) * size)
            if other == cell:
                own = n_near
            for i in range(starts[other], starts[other + 1]):
                x, y, z = local[0, i] + shift_x, local[1, i] + shift_y, local[2, i] + shift_z
                near_x[n_near], near_y[n_near], near_z[n_near] = x, y, z
                source[n_near] = i
                gx, gy, gz = max(abs(x) - half, _ZERO), max(abs(y) - half, _ZERO), max(abs(z) - half, _ZERO)
                n_near += gx * gx + gy * gy + gz * gz <= squared
    return n_near, own


@njit(cache=True, nogil=True, fastmath=FAST)
def distances(near: NDArray, n_near: int, own: int, squares: NDArray) -> None:
    """Write the squared distances of all candidates from one of them."""
    near_x, near_y, near_z = near[0], near[1], near[2]
    x, y, z = near_x[own], near_y[own], near_z[own]
    for k in range(n_near):
        dx, dy, dz = near_x[k] - x, near_y[k] - y, near_z[k] - z
        squares[k] = dx * dx + dy * dy + dz * dz
