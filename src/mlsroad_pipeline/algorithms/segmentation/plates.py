"""Plates that hang on masts: objects of their own, told from what belongs to a mast by their reflectivity.

A sign on a lamp's mast touches it, and its few voxels hardly weigh in a cut. By its shape alone it could be a box or a
lamp of the mast; retroreflective sheeting is brighter. What is as thin as sheet metal, as large as signs are and alone
on its mast need not be: its back is no brighter than the mast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import Stem, find_stems, whole_stems
from mlsroad_pipeline.algorithms.segmentation.trunks import judge_stems

_FREE = 1.2  # length over which a mast stands free, metres
_REACH = 1.2  # of a plate from the mast's axis, metres
_LOW, _HIGH = 1.2, 5.5  # above a mast's foot, between which plates hang, metres
_LEAST, _MOST = (0.3, 0.2), 1.6  # width and height of a plate, metres
_THICK, _TILT = 0.075, 0.5  # deviation from a plane, metres, and vertical part of its normal
_SHEET, _PLUMB = 0.02, 0.1  # the same of sheet metal
_WIDE, _TALL = (0.5, 1.3), 1.0  # width and height of a sheet that need not be bright, metres
_ALONE = 12  # voxels beside a mast above such a sheet, at most: there are no more plates
_VOXELS, _CRUMB = 8, 4  # of the smallest plate, and of a piece of one
_JOINED = 0.2  # voxels of one piece are this close, metres
_THIN, _MARGIN = (0.1, 0.25), 0.06  # radii that a mast may have, and what is added to the one found, metres
_SHAFT, _FOOT = 0.35, 0.4  # of an axis, within which a mast's radius is measured, and height from where, metres
_HALF = 0.05  # of a voxel: what its middle lies off the ends of what is in it, metres
_BRIGHTER, _DULLER = 0.02, -0.05  # the least difference of mean intensities, of any plate and of a sheet


def separate_plates(
    places: NDArray[np.float64], counts: NDArray[np.int64], parts: NDArray[np.int64], *, free_length: float
) -> NDArray[np.int64]:
    """Take plates that are bright or thin off the masts that they hang on.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 4)
        Voxels of about 0.1 m, metres, z up, and their intensities in [0, 1].
    counts : ndarray of int64, shape (v,)
        Points in each.
    parts : ndarray of int64, shape (v,)
        Part of each, 0, 1, ...
    free_length : float
        A mast goes on for at least this length above a plate, metres: a sign that stands on its own post ends with
        its plate. Larger takes off fewer.

    Returns
    -------
    ndarray of int64, shape (v,)
        The same parts, and a new number for the plates of each mast.
    """
    out = parts.copy()
    stems = find_stems(places[:, :3], parts.astype(np.int32), _FREE)
    last = int(parts.max(initial=-1))
    order = np.argsort(parts, kind="stable")
    for number, found in stems.items():
        first, stop = np.searchsorted(parts[order], [number, number + 1])
        members = order[first:stop]
        mast = _mast(places[members, :3], counts[members], found)
        if mast is None:
            continue
        plates = _plates(places[members], counts[members], mast, free_length)
        if plates:  # all that one mast carries are one sign, as on a post of their own
            last += 1
            out[members[np.concatenate(plates)]] = last
    return out


def _mast(xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem]) -> Stem | None:
    """Return the only stem of a part, if it carries no crown."""
    found = whole_stems(stems, xyz, counts)
    return found[0] if len(found) == 1 and judge_stems(xyz, counts, found)[0] else None


def _plates(
    places: NDArray[np.float64], counts: NDArray[np.int64], mast: Stem, free_length: float
) -> list[NDArray[np.int64]]:
    """Return the voxels of each plate of a mast, what lies behind it on the mast among them."""
    z, distance = places[:, 2], mast.distance(places[:, :3])
    shaft = (distance <= _SHAFT) & (z > mast.low + _FOOT) & (z < mast.high)
    radius = float(np.clip(np.percentile(distance[shaft], 75) + _MARGIN, *_THIN)) if shaft.any() else _THIN[0]
    beside = np.flatnonzero(distance > radius)
    bodies = _bodies(places, beside, distance[beside], mast, free_length)
    others = np.setdiff1d(beside, np.concatenate([*bodies, beside[:0]]))
    found = []
    for body in bodies:
        low, high = z[body].min() - _HALF, z[body].max() + _HALF
        normal, thickness, width = _plane(places[body, :3])
        tall, tilt = high - low - 2 * _HALF, abs(normal[2])
        if not (thickness <= _THICK and tilt <= _TILT and _LEAST[0] <= width <= _MOST and _LEAST[1] <= tall <= _MOST):
            continue
        level = (z >= low) & (z <= high)
        rest = (distance <= radius) & ~level & (z > mast.low)
        brighter = _mean(places, counts, body) - _mean(places, counts, np.flatnonzero(rest))
        sheet = thickness <= _SHEET and tilt <= _PLUMB and _WIDE[0] <= width <= _WIDE[1] and tall <= _TALL
        alone = ((z[others] > high) & (z[others] <= high + free_length)).sum() <= _ALONE
        if brighter < (_DULLER if sheet and alone else _BRIGHTER):
            continue
        behind = np.flatnonzero((distance <= radius) & level)
        off = np.abs((places[behind, :3] - places[body, :3].mean(axis=0)) @ normal)
        found.append(np.concatenate([body, behind[off <= max(1.5 * thickness, _MARGIN)]]))
    return found


def _bodies(
    places: NDArray[np.float64],
    beside: NDArray[np.int64],
    distance: NDArray[np.float64],
    mast: Stem,
    free_length: float,
) -> list[NDArray[np.int64]]:
    """Return what hangs on a mast between the heights of plates: pieces on both sides of it at one height are one."""
    if len(beside) < _VOXELS:
        return []
    z = places[beside, 2]
    piece = cluster(np.ascontiguousarray(places[beside, :3]), tolerance=_JOINED)
    n = int(piece.max()) + 1
    low, high, far = np.full(n, np.inf), np.full(n, -np.inf), np.zeros(n)
    np.minimum.at(low, piece, z)
    np.maximum.at(high, piece, z)
    np.maximum.at(far, piece, distance)
    top = min(mast.low + _HIGH, mast.high - free_length)
    good = np.flatnonzero((np.bincount(piece) >= _CRUMB) & (far <= _REACH) & (low >= mast.low + _LOW) & (high <= top))
    good = good[np.argsort(low[good], kind="stable")]
    if len(good) == 0:
        return []
    reached = np.maximum.accumulate(high[good])
    body = np.full(n, -1)
    body[good] = np.cumsum(np.append(False, low[good][1:] > reached[:-1]))
    of_voxel = body[piece]
    bodies = [beside[of_voxel == number] for number in range(int(body.max()) + 1)]
    return [voxels for voxels in bodies if len(voxels) >= _VOXELS]


def _plane(xyz: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, float]:
    """Return the normal of the plane of places, their deviation from it, and their horizontal width along it."""
    off = xyz - xyz.mean(axis=0)
    spread, axes = np.linalg.eigh(off.T @ off / len(xyz))
    normal = axes[:, 0]
    along = np.array([-normal[1], normal[0]]) / max(float(np.hypot(normal[0], normal[1])), 1e-9)
    return normal, float(np.sqrt(max(spread[0], 0.0))), float(np.ptp(off[:, :2] @ along))


def _mean(places: NDArray[np.float64], counts: NDArray[np.int64], rows: NDArray[np.int64]) -> float:
    """Return the mean intensity of the points of voxels; that of none is above all."""
    return float(np.average(places[rows, 3], weights=counts[rows])) if len(rows) else np.inf
