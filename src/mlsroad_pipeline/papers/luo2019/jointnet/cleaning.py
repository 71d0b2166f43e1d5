"""Statistical outlier removal from objects."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS = 4
"""Nearest points whose mean distance is the spacing of a point."""

PASSES = 3
"""Most passes; outliers close to each other are isolated once others have gone."""

_LEAST_SHARE = 0.5
_BY_PAIRS = 1500
"""Largest number of points of an object whose distances are computed pair by pair; a search tree serves larger ones."""


def isolated_points(
    xyz: NDArray[np.float64], indptr: NDArray[np.int64], *, factor: float, least: int
) -> NDArray[np.bool_]:
    """Return the points of objects that are isolated."""
    alone = np.zeros(len(xyz), dtype=np.bool_)
    for first, last in zip(indptr[:-1].tolist(), indptr[1:].tolist(), strict=True):
        if last - first > least:
            alone[first:last] = _isolated(xyz[first:last], factor, least)
    return alone


def _isolated(xyz: NDArray[np.float64], factor: float, least: int) -> NDArray[np.bool_]:
    keep = np.ones(len(xyz), dtype=np.bool_)
    for _ in range(PASSES):
        rows = np.flatnonzero(keep)
        if len(rows) <= max(least, NEIGHBOURS):
            break
        spacing = _spacing(xyz[rows])
        alone = spacing > factor * np.median(spacing)
        if not alone.any() or len(rows) - alone.sum() < _LEAST_SHARE * len(xyz):
            break
        keep[rows[alone]] = False
    return ~keep


def _spacing(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean distance of the nearest points of each point."""
    if len(xyz) <= _BY_PAIRS:
        return _spacing_by_pairs(np.ascontiguousarray(xyz - xyz[0]))
    distance, _ = cKDTree(xyz).query(xyz, k=NEIGHBOURS + 1)
    mean: NDArray[np.float64] = distance[:, 1:].mean(axis=1)
    return mean


@njit(cache=True, nogil=True)
def _spacing_by_pairs(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    n = len(xyz)
    nearest = np.full((n, NEIGHBOURS), np.inf)
    for i in range(n):
        for j in range(i):
            square = (xyz[i, 0] - xyz[j, 0]) ** 2 + (xyz[i, 1] - xyz[j, 1]) ** 2 + (xyz[i, 2] - xyz[j, 2]) ** 2
            for own in (i, j):
                if square < nearest[own, NEIGHBOURS - 1]:
                    k = NEIGHBOURS - 1
                    while k > 0 and nearest[own, k - 1] > square:
                        nearest[own, k] = nearest[own, k - 1]
                        k -= 1
                    nearest[own, k] = square
    out = np.zeros(n)
    for i in range(n):
        for k in range(NEIGHBOURS):
            out[i] += np.sqrt(nearest[i, k]) / NEIGHBOURS
    return out
