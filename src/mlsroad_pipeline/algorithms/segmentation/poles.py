"""Separation of poles from the clusters that they share with plants and with objects that lean on them.

A cut along the weights of equation 19 does not separate a thin pole from a crown around it: the side of few voxels has
most of its weight across the cut. A pole is therefore detected by its shape: a narrow upright line that stands free
over some of its length and continues through the crown, denser than its surroundings. Below the crown a trunk has the
same shape; `trunks.py` separates the two by the crown, which surrounds a trunk on all sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.pole_parameters import POLE_REFINEMENT, PoleRefinementParameters
from mlsroad_pipeline.algorithms.segmentation.stems import Stem, find_stems, measure_sections, whole_stems
from mlsroad_pipeline.algorithms.segmentation.trunks import classify_stems


def separate_poles(
    places: NDArray[np.float64],
    counts: NDArray[np.int64],
    clusters: NDArray[np.int32],
    *,
    free_length: float,
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Take poles out of clusters that contain other objects, and find the legs of gantries.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 3)
        Voxels of about 0.1 m, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.
    clusters : ndarray of int32, shape (v,)
        Cluster of each, 0, 1, ...
    free_length : float
        Length over which a pole stands free, below a crown or above a shrub, metres. Larger finds fewer.
    refinement : PoleRefinementParameters
        Limits and weights.

    Returns
    -------
    clusters : ndarray of int32, shape (v,)
        The same clusters, with new numbers for the parts of those that contained poles.
    links : ndarray of int64, shape (k, 2)
        Pairs of voxels on the legs of one gantry, which remains one object wherever it is cut.
    """
    stems = find_stems(places, clusters, free_length, refinement)
    out, last = clusters.copy(), int(clusters.max(initial=-1))
    links = [np.zeros((0, 2), np.int64)]
    if not stems:
        return out, links[0]
    order = np.argsort(clusters, kind="stable")
    for number, lines in stems.items():
        first, stop = np.searchsorted(clusters[order], [number, number + 1])
        members = order[first:stop]
        parts, legs = _split(places[members], counts[members], lines, refinement)
        links.append(members[legs])
        out[members] = np.where(parts > 0, parts + last, number)
        last += int(parts.max())
    return out, np.concatenate(links)


def _split(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem], p: PoleRefinementParameters
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the part of each voxel of a cluster, and pairs of voxels on the legs of gantries.

    Part 0 keeps the number of the cluster; 1, 2, ... are poles and what they connected.
    """
    stems = whole_stems(stems, xyz, counts, p)
    parts = np.zeros(len(xyz), np.int64)
    poles, gantries = classify_stems(xyz, counts, stems, p)
    at = [[_middle(leg, xyz) for leg in legs] for legs in gantries]
    links = np.array([(legs[0], leg) for legs in at for leg in legs[1:]], np.int64).reshape(-1, 2)
    if not poles:
        return parts, links
    for number, stem in enumerate(poles, start=1):
        parts[_shaft(stem, xyz, p) & (parts == 0)] = number
    _attach(xyz, parts, poles, p)
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        # The cluster consists of poles alone: the first of them keeps its number.
        return np.maximum(parts - 1, 0), links
    left = cluster(np.ascontiguousarray(xyz[rest]), tolerance=p.remainder_tolerance).astype(np.int64)
    parts[rest] = np.where(left > 0, left + len(poles), 0)
    return parts, links


def _middle(stem: Stem, xyz: NDArray[np.float64]) -> int:
    """Return the voxel that is nearest to the middle of a stem."""
    height = 0.5 * (stem.low + stem.high)
    place = np.append(stem.at(height), height)
    return int(((xyz - place) ** 2).sum(axis=1).argmin())


def _shaft(stem: Stem, xyz: NDArray[np.float64], p: PoleRefinementParameters) -> NDArray[np.bool_]:
    """Return which voxels belong to the shaft of a pole.

    These are all close to its axis; in surrounded sections near the foot, as beside a bin, only those within the radius
    measured above.
    """
    distance, height = stem.distance(xyz), xyz[:, 2] - stem.low
    near = np.flatnonzero((distance <= p.surround_radius) & (xyz[:, 2] <= stem.high + p.section_height))
    slab = np.floor(height[near] / p.section_height).astype(np.int64)
    first = int(slab.min())
    slab -= first
    inside = distance[near] <= p.stem_radius
    own = np.bincount(slab[inside], minlength=int(slab.max()) + 1)
    surrounded = np.bincount(slab[~inside], minlength=len(own)) > p.surround_ratio * own
    low = (np.arange(len(own)) + first) * p.section_height < p.base_zone
    above = distance[near[inside & ~(surrounded | low)[slab]]]
    radius = p.pole_min_radius
    if len(above):
        radius = float(np.clip(np.median(above) + p.pole_radius_margin, p.pole_min_radius, p.pole_max_radius))
    shaft = np.zeros(len(xyz), np.bool_)
    shaft[near] = distance[near] <= np.where((surrounded & low)[slab], radius, p.stem_radius)
    return shaft


def _attach(xyz: NDArray[np.float64], parts: NDArray[np.int64], poles: list[Stem], p: PoleRefinementParameters) -> None:
    """Assign arms, lamps and plates to poles, in place: small pieces that touch nothing else."""
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        return
    piece = cluster(np.ascontiguousarray(xyz[rest]), tolerance=p.fixture_tolerance).astype(np.int64)
    _, width, size = measure_sections(xyz[rest], piece)
    low = np.full(len(size), np.inf)
    np.minimum.at(low, piece, xyz[rest, 2])
    small = (size <= p.fixture_max_voxels) & (width <= p.fixture_max_width)
    for number, stem in enumerate(poles, start=1):
        touching = np.zeros(len(size), np.bool_)
        below_top = xyz[rest, 2] <= stem.high + p.fixture_overhang
        touching[piece[(stem.distance(xyz[rest]) <= p.stem_radius + p.fixture_tolerance) & below_top]] = True
        own = touching & small & (low >= stem.low + p.fixture_min_height)
        for k in np.flatnonzero(touching & ~small & (low >= stem.low + p.arm_min_height)):
            own[k] = _is_arm(xyz[rest[piece == k]], p)
        target = number
        for first in np.unique(parts[rest[own[piece]]]).tolist():
            # Two posts that carry one plate between them are one sign.
            if 0 < first != target and _level(poles[first - 1], stem, p):
                parts[parts == target] = first
                target = first
        parts[rest[own[piece] & (parts[rest] == 0)]] = target


def _is_arm(places: NDArray[np.float64], p: PoleRefinementParameters = POLE_REFINEMENT) -> bool:
    """Return whether a piece is the long arm of a mast: crowns are wider or higher."""
    flat = places[:, :2] - places[:, :2].mean(axis=0)
    along = np.linalg.eigh(flat.T @ flat)[1]
    width, length = np.ptp(flat @ along, axis=0)
    return bool(length <= p.arm_max_length and width <= p.arm_max_width and np.ptp(places[:, 2]) <= p.arm_max_height)


def _level(one: Stem, other: Stem, p: PoleRefinementParameters) -> bool:
    """Return whether two poles are close and their tops about level."""
    height = 0.5 * (one.low + one.high)
    step = one.base + one.slope * height - other.base - other.slope * height
    return bool(np.hypot(*step) <= p.post_max_distance and abs(one.high - other.high) <= p.post_max_level)
