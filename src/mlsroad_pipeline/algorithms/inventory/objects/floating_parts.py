"""Arms and lamps of poles that the scanner saw apart from their mast."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_CLEARANCE = 2.5  # least height of a floating part above the ground, metres: a lower one stands on its own
_MAST = 3.0  # least height of a mast that carries parts, metres
_GAP = 1.2  # largest gap between a part and the pole, metres
_REACH = 4.0  # largest horizontal distance of a part's points from the middle of the mast, metres
_BELOW = 3.0  # largest depth of a part's lowest point below the top of the mast, metres
_ROUNDS = 3  # an arm may carry a lamp beyond another gap


def join_floating_parts(
    local: NDArray[np.floating], height: NDArray[np.floating], label: NDArray[np.integer]
) -> NDArray[np.int64]:
    """Give floating clusters the number of the pole that they hang on.

    Where points are sparse, the gaps along an arm exceed the tolerance of the clustering: the lamp becomes an object of
    its own, which is none, and the pole ends below it. A cluster floats if all its points are 2.5 m above the ground.
    """
    out = np.asarray(label, dtype=np.int64).copy()
    n = int(out.max(initial=-1)) + 1
    if n == 0:
        return out
    lowest, highest = np.full(n, np.inf), np.full(n, -np.inf)
    np.fmin.at(lowest, out, height)
    np.fmax.at(highest, out, height)
    stands = (lowest < _CLEARANCE) & (highest >= _MAST)
    floats = np.isfinite(lowest) & (lowest >= _CLEARANCE)
    middle = np.array([np.bincount(out, local[:, axis], n) for axis in (0, 1)]).T
    middle /= np.maximum(np.bincount(out, minlength=n), 1)[:, None]
    owner = np.where(stands, np.arange(n), -1)
    for _ in range(_ROUNDS):
        part = np.flatnonzero(floats[out] & (owner[out] < 0))
        pole = np.flatnonzero(owner[out] >= 0)
        if not len(part) or not len(pole):
            break
        mast = _masts(local, out, part, pole, owner)
        near = np.flatnonzero(mast >= 0)
        reach = np.zeros(n)
        ends = local[part, :2] - middle[np.maximum(mast[out[part]], 0)]
        np.maximum.at(reach, out[part], np.hypot(ends[:, 0], ends[:, 1]))
        fits = (reach[near] <= _REACH) & (lowest[near] >= highest[mast[near]] - _BELOW)
        if not fits.any():
            break
        owner[near[fits]] = mast[near[fits]]
    return np.where(floats & (owner >= 0), owner, np.arange(n))[out]


def _masts(
    local: NDArray[np.floating],
    label: NDArray[np.int64],
    part: NDArray[np.int64],
    pole: NDArray[np.int64],
    owner: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the pole nearest to each floating cluster within the gap, -1 for none."""
    distance, nearest = cKDTree(local[pole]).query(local[part], distance_upper_bound=_GAP)
    order = np.lexsort((distance, label[part]))
    first = order[np.diff(label[part][order], prepend=-1) != 0]
    first = first[np.isfinite(distance[first])]
    mast = np.full(len(owner), -1, dtype=np.int64)
    mast[label[part[first]]] = owner[label[pole[nearest[first]]]]
    return mast
