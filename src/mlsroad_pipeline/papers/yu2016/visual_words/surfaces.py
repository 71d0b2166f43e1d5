"""Local shape of an object around each of its voxels: line, plane or neither, and its inclination."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.eigen_solver import solve_symmetric

KINDS = 8
"""Number of kinds: vertical, inclined and horizontal lines; vertical, inclined and horizontal planes; neither; and
undefined for too few neighbours."""

_REACH = 2  # neighbourhood in each direction, voxels
_LEAST = 4  # fewest voxels, including the voxel itself
_LINE = 0.9, 0.4  # least vertical component of the direction of a vertical line, and of an inclined one
_PLANE = 0.3, 0.8  # least vertical component of the normal of an inclined plane, and of a horizontal one


def surface_kinds(
    places: NDArray[np.float64], cells: NDArray[np.int64], starts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Classify the local shape around each voxel from the voxels of its object."""
    scatter, counts = _scatter(places, cells, starts)
    values, normals, directions = (np.empty((3, len(places))) for _ in range(3))
    solve_symmetric(scatter, len(places), values, normals, directions)
    long, middle, short = np.sqrt(values)
    dimension = np.argmax([long - middle, middle - short, short], axis=0)
    line = 2 - np.searchsorted(_LINE[::-1], np.abs(directions[2]))
    plane = 3 + np.searchsorted(_PLANE, np.abs(normals[2]))
    kinds = np.choose(dimension, [line, plane, np.full(len(places), 6)])
    return np.where(counts < _LEAST, KINDS - 1, kinds)


@njit(cache=True, nogil=True)
def _scatter(
    places: NDArray[np.float64], cells: NDArray[np.int64], starts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the covariances xx, xy, xz, yy, yz, zz of the voxels around each, (6, v), and their numbers."""
    covariances, counts = np.zeros((6, len(places))), np.zeros(len(places), np.int64)
    sums = np.empty(9)
    for k in range(len(starts) - 1):
        for i in range(starts[k], starts[k + 1]):
            counts[i] = _sum_around(places, cells, starts[k], starts[k + 1], i, sums)
            mean = sums[:3] / counts[i]
            at = 0
            for a in range(3):
                for b in range(a, 3):
                    covariances[at, i] = sums[3 + at] / counts[i] - mean[a] * mean[b]
                    at += 1
    return covariances, counts


@njit(cache=True, nogil=True)
def _sum_around(
    places: NDArray[np.float64], cells: NDArray[np.int64], first: int, stop: int, i: int, sums: NDArray[np.float64]
) -> int:
    """Sum offsets from a voxel, and their products, over the voxels of an object around it; return their number."""
    n = 0
    sums[:] = 0.0
    z, y, x = cells[i]
    for dz in range(-_REACH, _REACH + 1):
        for dy in range(-_REACH, _REACH + 1):
            j = _first_from(cells, first, stop, z + dz, y + dy, x - _REACH)
            while j < stop and cells[j, 0] == z + dz and cells[j, 1] == y + dy and cells[j, 2] <= x + _REACH:
                a, b, c = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], places[j, 2] - places[i, 2]
                sums[0] += a
                sums[1] += b
                sums[2] += c
                sums[3] += a * a
                sums[4] += a * b
                sums[5] += a * c
                sums[6] += b * b
                sums[7] += b * c
                sums[8] += c * c
                n += 1
                j += 1
    return n


@njit(cache=True, nogil=True)
def _first_from(cells: NDArray[np.int64], first: int, stop: int, z: int, y: int, x: int) -> int:
    """Return the first voxel of an object whose cell does not precede (z, y, x), by binary search."""
    while first < stop:
        middle = (first + stop) // 2
        cz, cy, cx = cells[middle, 0], cells[middle, 1], cells[middle, 2]
        if cz < z or (cz == z and (cy < y or (cy == y and cx < x))):
            first = middle + 1
        else:
            stop = middle
    return first
