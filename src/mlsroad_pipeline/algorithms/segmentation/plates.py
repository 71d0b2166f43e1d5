"""Separation of plates, such as signs, from the masts that carry them.

A sign on a lamp's mast touches it, and its few voxels have little weight in a cut. By its shape alone it could be a box
or a lamp of the mast; retroreflective sheeting is brighter. The back of a sign is not: a single plate as thin as sheet
metal and as large as a sign need not be brighter. None of this is in Yu et al. 2016.
"""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.crowned_stems import find_poles
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import Stem, find_stems

# Limits set by hand: the mast.
_FREE_LENGTH = 1.2  # m over which a mast of plates stands free
_MIN_RADIUS, _MAX_RADIUS, _RADIUS_MARGIN = 0.1, 0.25, 0.06  # m, range of its radius, and what is added to the measured
_RADIUS_PERCENTILE = 75  # of the distances from the axis, which measures the radius
_SEARCH_RADIUS, _SEARCH_BASE = 0.35, 0.4  # m, largest distance and least height above the foot of the voxels measured

# Any plate.
_REACH, _LOW, _HIGH = 1.2, 1.2, 5.5  # m, largest distance from the axis, and range of heights above the foot
_MIN_WIDTH, _MIN_HEIGHT, _MAX_SIZE = 0.3, 0.2, 1.6  # m, least width and height, and the largest of both
_MAX_THICKNESS, _MAX_TILT = 0.075, 0.5  # m from a plane; largest vertical component of its normal
_MIN_VOXELS, _MIN_PIECE, _TOLERANCE = 8, 4, 0.2  # voxels of a plate, and of a part of it with this distance (m) between
_MIN_CONTRAST = 0.02  # of mean intensities in [0, 1] between plate and mast; larger separates fewer
_BACK_FACTOR = 1.5  # voxels on the mast belong to a plate within this multiple of its thickness from its plane

# Plates of sheet metal, which need not be brighter than the mast.
_SHEET_THICKNESS, _SHEET_TILT, _SHEET_CONTRAST = 0.02, 0.1, -0.05  # as above
_SHEET_MIN_WIDTH, _SHEET_MAX_WIDTH, _SHEET_HEIGHT = 0.5, 1.3, 1.0  # m
_SHEET_NEIGHBORS = 12  # most voxels beside the mast above it: a sheet that is not bright is the only plate there
_HALF_EDGE = 0.05  # m, from the centre of a voxel to its faces


def separate_plates(
    places: NDArray[np.float64], counts: NDArray[np.int64], parts: NDArray[np.int64], *, free_length: float
) -> NDArray[np.int64]:
    """Separate bright or thin plates from masts that go on for `free_length`, m, above; each mast's get a new number.

    `places` are x, y, z and intensity of voxels of about 0.1 m; the post of a sign of its own ends with its plate.
    """
    out = parts.copy()
    last = int(parts.max(initial=-1))
    for _, members, stems in find_stems(places[:, :3], counts, parts.astype(np.int32), _FREE_LENGTH):
        if len(stems) != 1 or not find_poles(places[members, :3], counts[members], stems)[0]:
            continue  # only a single stem without a crown is a mast
        plates = _plates(places[members], counts[members], stems[0], free_length)
        if plates:  # all plates of one mast are one sign, as on a post of their own
            last += 1
            out[members[np.concatenate(plates)]] = last
    return out


def _plates(
    places: NDArray[np.float64], counts: NDArray[np.int64], mast: Stem, free_length: float
) -> list[NDArray[np.int64]]:
    """Return the voxels of each plate of a mast, including those behind it on the mast."""
    z, distance = places[:, 2], mast.distance(places[:, :3])
    radius = _mast_radius(distance, z, mast)
    beside = np.flatnonzero(distance > radius)
    bodies = _candidates(places, beside, distance[beside], mast, free_length)
    others = np.setdiff1d(beside, np.concatenate([*bodies, beside[:0]]))
    plates = []
    for body in bodies:
        low, high = z[body].min() - _HALF_EDGE, z[body].max() + _HALF_EDGE
        normal, thickness, width = _plane(places[body, :3])
        tall, tilt = high - low - 2 * _HALF_EDGE, abs(normal[2])
        large = _MIN_WIDTH <= width <= _MAX_SIZE and _MIN_HEIGHT <= tall <= _MAX_SIZE
        if not (thickness <= _MAX_THICKNESS and tilt <= _MAX_TILT and large):
            continue
        level = (z >= low) & (z <= high)
        rest = (distance <= radius) & ~level & (z > mast.low)
        contrast = _mean(places, counts, body) - _mean(places, counts, np.flatnonzero(rest))
        thin = thickness <= _SHEET_THICKNESS and tilt <= _SHEET_TILT
        sheet = thin and _SHEET_MIN_WIDTH <= width <= _SHEET_MAX_WIDTH and tall <= _SHEET_HEIGHT
        alone = ((z[others] > high) & (z[others] <= high + free_length)).sum() <= _SHEET_NEIGHBORS
        if contrast < (_SHEET_CONTRAST if sheet and alone else _MIN_CONTRAST):
            continue
        behind = np.flatnonzero((distance <= radius) & level)
        off = np.abs((places[behind, :3] - places[body, :3].mean(axis=0)) @ normal)
        reach = max(_BACK_FACTOR * thickness, _RADIUS_MARGIN)
        plates.append(np.concatenate([body, behind[off <= reach]]))
    return plates


def _mast_radius(distance: NDArray[np.float64], z: NDArray[np.float64], mast: Stem) -> float:
    """Return the radius of a mast, metres."""
    shaft = (distance <= _SEARCH_RADIUS) & (z > mast.low + _SEARCH_BASE) & (z < mast.high)
    if not shaft.any():
        return _MIN_RADIUS
    measured = np.percentile(distance[shaft], _RADIUS_PERCENTILE) + _RADIUS_MARGIN
    return float(np.clip(measured, _MIN_RADIUS, _MAX_RADIUS))


def _candidates(
    places: NDArray[np.float64], beside: NDArray[np.int64], distance: NDArray[np.float64], mast: Stem,
    free_length: float,
) -> list[NDArray[np.int64]]:  # fmt: skip
    """Return the voxels of each candidate plate; pieces of one height on both sides of the mast are one candidate."""
    if len(beside) < _MIN_VOXELS:
        return []
    z = places[beside, 2]
    piece = cluster(np.ascontiguousarray(places[beside, :3]), tolerance=_TOLERANCE)
    n = int(piece.max()) + 1
    low, high, far = np.full(n, np.inf), np.full(n, -np.inf), np.zeros(n)
    np.minimum.at(low, piece, z)
    np.maximum.at(high, piece, z)
    np.maximum.at(far, piece, distance)
    top = min(mast.low + _HIGH, mast.high - free_length)
    inside = (far <= _REACH) & (low >= mast.low + _LOW) & (high <= top)
    good = np.flatnonzero((np.bincount(piece) >= _MIN_PIECE) & inside)
    good = good[np.argsort(low[good], kind="stable")]
    if len(good) == 0:
        return []
    reached = np.maximum.accumulate(high[good])
    body = np.full(n, -1)
    body[good] = np.cumsum(np.append(False, low[good][1:] > reached[:-1]))
    of_voxel = body[piece]
    bodies = [beside[of_voxel == number] for number in range(int(body.max()) + 1)]
    return [voxels for voxels in bodies if len(voxels) >= _MIN_VOXELS]


def _plane(xyz: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, float]:
    """Return the normal of the plane of places, their deviation from it, and their horizontal width along it."""
    off = xyz - xyz.mean(axis=0)
    spread, axes = np.linalg.eigh(off.T @ off / len(xyz))
    normal = axes[:, 0]
    along = np.array([-normal[1], normal[0]]) / max(float(np.hypot(normal[0], normal[1])), 1e-9)
    return normal, float(np.sqrt(max(spread[0], 0.0))), float(np.ptp(off[:, :2] @ along))


def _mean(places: NDArray[np.float64], counts: NDArray[np.int64], rows: NDArray[np.int64]) -> float:
    """Return the mean intensity of the points of voxels; infinity for no voxels."""
    return float(np.average(places[rows, 3], weights=counts[rows])) if len(rows) else np.inf
