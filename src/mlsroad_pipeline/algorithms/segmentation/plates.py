"""Separation of plates, such as signs, from the masts that carry them.

A sign on a lamp's mast touches it, and its few voxels have little weight in a cut. By its shape alone it could be a box
or a lamp of the mast; retroreflective sheeting is brighter. The back of a sign is not: a single plate as thin as sheet
metal and as large as a sign need not be brighter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.pole_parameters import POLE_REFINEMENT, PoleRefinementParameters
from mlsroad_pipeline.algorithms.segmentation.stems import Stem, find_stems, whole_stems
from mlsroad_pipeline.algorithms.segmentation.trunks import classify_stems


def separate_plates(
    places: NDArray[np.float64],
    counts: NDArray[np.int64],
    parts: NDArray[np.int64],
    *,
    free_length: float,
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
) -> NDArray[np.int64]:
    """Separate bright or thin plates from the masts that carry them.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 4)
        Voxels of about 0.1 m, metres, z up, and their intensities in [0, 1].
    counts : ndarray of int64, shape (v,)
        Points in each.
    parts : ndarray of int64, shape (v,)
        Part of each, 0, 1, ...
    free_length : float
        Minimum length of mast above a plate, metres: the post of a sign of its own ends with its plate. Larger
        separates fewer.
    refinement : PoleRefinementParameters
        Limits of masts, plates and sheets.

    Returns
    -------
    ndarray of int64, shape (v,)
        The same parts, with a new number for the plates of each mast.
    """
    out = parts.copy()
    stems = find_stems(places[:, :3], parts.astype(np.int32), refinement.mast_free_length, refinement)
    last = int(parts.max(initial=-1))
    order = np.argsort(parts, kind="stable")
    for number, lines in stems.items():
        first, stop = np.searchsorted(parts[order], [number, number + 1])
        members = order[first:stop]
        mast = _mast(places[members, :3], counts[members], lines, refinement)
        if mast is None:
            continue
        plates = _plates(places[members], counts[members], mast, free_length, refinement)
        if plates:  # all plates of one mast are one sign, as on a post of their own
            last += 1
            out[members[np.concatenate(plates)]] = last
    return out


def _mast(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem], p: PoleRefinementParameters
) -> Stem | None:
    """Return the only stem of a part, if it carries no crown."""
    whole = whole_stems(stems, xyz, counts, p)
    return whole[0] if len(whole) == 1 and classify_stems(xyz, counts, whole, p)[0] else None


def _plates(
    places: NDArray[np.float64],
    counts: NDArray[np.int64],
    mast: Stem,
    free_length: float,
    p: PoleRefinementParameters,
) -> list[NDArray[np.int64]]:
    """Return the voxels of each plate of a mast, including those behind it on the mast."""
    z, distance = places[:, 2], mast.distance(places[:, :3])
    radius = _mast_radius(distance, z, mast, p)
    beside = np.flatnonzero(distance > radius)
    bodies = _candidates(places, beside, distance[beside], mast, free_length, p)
    others = np.setdiff1d(beside, np.concatenate([*bodies, beside[:0]]))
    plates = []
    for body in bodies:
        low, high = z[body].min() - p.voxel_half_edge, z[body].max() + p.voxel_half_edge
        normal, thickness, width = _plane(places[body, :3])
        tall, tilt = high - low - 2 * p.voxel_half_edge, abs(normal[2])
        large = p.plate_min_width <= width <= p.plate_max_size and p.plate_min_extent <= tall <= p.plate_max_size
        if not (thickness <= p.plate_max_thickness and tilt <= p.plate_max_tilt and large):
            continue
        level = (z >= low) & (z <= high)
        rest = (distance <= radius) & ~level & (z > mast.low)
        contrast = _mean(places, counts, body) - _mean(places, counts, np.flatnonzero(rest))
        thin = thickness <= p.sheet_max_thickness and tilt <= p.sheet_max_tilt
        sheet = thin and p.sheet_min_width <= width <= p.sheet_max_width and tall <= p.sheet_max_extent
        alone = ((z[others] > high) & (z[others] <= high + free_length)).sum() <= p.sheet_max_neighbors
        if contrast < (p.sheet_min_contrast if sheet and alone else p.plate_min_contrast):
            continue
        behind = np.flatnonzero((distance <= radius) & level)
        off = np.abs((places[behind, :3] - places[body, :3].mean(axis=0)) @ normal)
        reach = max(p.plate_back_factor * thickness, p.mast_radius_margin)
        plates.append(np.concatenate([body, behind[off <= reach]]))
    return plates


def _mast_radius(
    distance: NDArray[np.float64], z: NDArray[np.float64], mast: Stem, p: PoleRefinementParameters
) -> float:
    """Return the radius of a mast, metres."""
    shaft = (distance <= p.mast_search_radius) & (z > mast.low + p.mast_search_base) & (z < mast.high)
    if not shaft.any():
        return p.mast_min_radius
    measured = np.percentile(distance[shaft], p.mast_percentile) + p.mast_radius_margin
    return float(np.clip(measured, p.mast_min_radius, p.mast_max_radius))


def _candidates(
    places: NDArray[np.float64],
    beside: NDArray[np.int64],
    distance: NDArray[np.float64],
    mast: Stem,
    free_length: float,
    p: PoleRefinementParameters,
) -> list[NDArray[np.int64]]:
    """Return the voxels of each candidate plate; pieces of one height on both sides of the mast are one candidate."""
    if len(beside) < p.plate_min_voxels:
        return []
    z = places[beside, 2]
    piece = cluster(np.ascontiguousarray(places[beside, :3]), tolerance=p.plate_tolerance)
    n = int(piece.max()) + 1
    low, high, far = np.full(n, np.inf), np.full(n, -np.inf), np.zeros(n)
    np.minimum.at(low, piece, z)
    np.maximum.at(high, piece, z)
    np.maximum.at(far, piece, distance)
    top = min(mast.low + p.plate_max_height, mast.high - free_length)
    inside = (far <= p.plate_reach) & (low >= mast.low + p.plate_min_height) & (high <= top)
    good = np.flatnonzero((np.bincount(piece) >= p.plate_min_piece) & inside)
    good = good[np.argsort(low[good], kind="stable")]
    if len(good) == 0:
        return []
    reached = np.maximum.accumulate(high[good])
    body = np.full(n, -1)
    body[good] = np.cumsum(np.append(False, low[good][1:] > reached[:-1]))
    of_voxel = body[piece]
    bodies = [beside[of_voxel == number] for number in range(int(body.max()) + 1)]
    return [voxels for voxels in bodies if len(voxels) >= p.plate_min_voxels]


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
