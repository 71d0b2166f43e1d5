"""Statistical outlier removal from objects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS = 4
"""Nearest points whose mean distance is the spacing of a point."""

PASSES = 3
"""Most passes; outliers close to each other are isolated once others have gone."""

_LEAST_SHARE = 0.5
_APART = 10.0
"""Distance of objects from each other in the fourth dimension of the search tree, in radii of the largest object."""


def isolated_points(
    xyz: NDArray[np.float64], indptr: NDArray[np.int64], *, factor: float, least: int
) -> NDArray[np.bool_]:
    """Return the points of objects that are isolated.

    Parameters
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Points, object by object, metres.
    indptr : ndarray of int64, shape (objects + 1,)
        Start of the points of each object.
    factor : float
        A point is isolated if the mean distance of its four nearest points of the object is more than this factor times
        the median of the object.
    least : int
        Objects with at most this number of points are left as they are.

    Returns
    -------
    ndarray of bool, shape (n,)
        Isolated points; none of a pass that would leave an object with less than half of its points.
    """
    keep = np.ones(len(xyz), dtype=np.bool_)
    for _ in range(PASSES):
        rows = np.flatnonzero(keep)
        owner = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))[rows]
        alone = _isolated(xyz[rows], owner, len(indptr) - 1, factor, least)
        alone &= _within_half(alone, owner, indptr)
        if not alone.any():
            break
        keep[rows[alone]] = False
    return ~keep


def _isolated(
    xyz: NDArray[np.float64], owner: NDArray[np.int64], n_objects: int, factor: float, least: int
) -> NDArray[np.bool_]:
    counts = np.bincount(owner, minlength=n_objects)
    start = np.append(0, np.cumsum(counts))[:-1]
    low = xyz[start[owner]]
    local = xyz - low
    apart = _APART * max(float(np.sqrt((local**2).sum(axis=1)).max(initial=0.0)), 1.0)
    tree = cKDTree(np.column_stack([local, owner * apart]))
    distance, _ = tree.query(tree.data, k=NEIGHBOURS + 1, distance_upper_bound=apart)
    known = np.isfinite(distance[:, 1:])
    spacing = np.where(known, distance[:, 1:], 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    order = np.lexsort((spacing, owner))
    median = spacing[order][start + np.maximum(counts - 1, 0) // 2]
    isolated: NDArray[np.bool_] = (spacing > factor * median[owner]) & (counts[owner] > least)
    return isolated


def _within_half(alone: NDArray[np.bool_], owner: NDArray[np.int64], indptr: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the points of objects that keep at least half of their points when the isolated ones go."""
    n_objects = len(indptr) - 1
    left = np.bincount(owner[~alone], minlength=n_objects)
    return (left >= _LEAST_SHARE * np.diff(indptr))[owner]
