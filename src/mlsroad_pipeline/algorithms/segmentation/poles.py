"""Poles taken out of the clusters that they share with plants and with what leans on them.

A cut along the weights of equation 19 does not part a thin pole from a crown around it: the side of few voxels has most
of its weight across the cut. A pole is therefore looked for by its shape: a narrow upright line that stands free over
some of its length and goes on, denser than what is around it, through the crown. A trunk looks the same up to where the
crown begins; it is told from a pole by the crown, which lies around it on all sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import (
    RADIUS,
    SLAB,
    Stem,
    find_stems,
    measure_sections,
    whole_stems,
)
from mlsroad_pipeline.algorithms.segmentation.trunks import judge_stems

_FIXTURE, _REACH, _ABOVE = 200, 4.0, 1.0  # voxels and width of lamps, arms and plates, and their least height, metres
_ARM = 12.0, 0.9, 1.6, 3.0  # length, width, height and least height above ground of a long arm with signals, metres
_AROUND, _CROWD = 0.45, 0.5  # metres around a section that is surrounded, and voxels there over those inside
_LOW = 1.2  # above its foot, up to where things stand beside a pole, metres
_THICK, _MARGIN = (0.14, 0.22), 0.05  # radii that a pole may have there, and what is added to that above, metres
_APART = 0.5  # what is left of a cluster and lies farther apart falls into parts, metres
_POSTS, _LEVEL = 2.5, 0.5  # the farthest two posts of one plate, and the most that their tops differ, metres


def separate_poles(
    places: NDArray[np.float64], counts: NDArray[np.int64], clusters: NDArray[np.int32], *, free_length: float
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Take poles out of clusters that hold other things too, and find the legs of gantries.

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

    Returns
    -------
    clusters : ndarray of int32, shape (v,)
        The same clusters, and new numbers for the parts of those that held poles.
    links : ndarray of int64, shape (k, 2)
        Voxels of legs of one gantry, which is one object wherever it is cut.
    """
    stems = find_stems(places, clusters, free_length)
    out, last = clusters.copy(), int(clusters.max(initial=-1))
    links = [np.zeros((0, 2), np.int64)]
    if not stems:
        return out, links[0]
    order = np.argsort(clusters, kind="stable")
    for number, found in stems.items():
        first, stop = np.searchsorted(clusters[order], [number, number + 1])
        members = order[first:stop]
        parts, legs = _split(places[members], counts[members], found)
        links.append(members[legs])
        out[members] = np.where(parts > 0, parts + last, number)
        last += int(parts.max())
    return out, np.concatenate(links)


def _split(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the part of each voxel of a cluster: 0 for what stays, 1, 2, ... for poles and what they held together.

    And pairs of voxels on the legs of gantries.
    """
    stems = whole_stems(stems, xyz, counts)
    parts = np.zeros(len(xyz), np.int64)
    poles, gantries = judge_stems(xyz, counts, stems)
    at = [[_middle(leg, xyz) for leg in legs] for legs in gantries]
    links = np.array([(legs[0], leg) for legs in at for leg in legs[1:]], np.int64).reshape(-1, 2)
    if not poles:
        return parts, links
    for number, stem in enumerate(poles, start=1):
        parts[_shaft(stem, xyz) & (parts == 0)] = number
    _attach(xyz, parts, poles)
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        # The whole cluster is poles: the first of them keeps the number.
        return np.maximum(parts - 1, 0), links
    left = cluster(np.ascontiguousarray(xyz[rest]), tolerance=_APART).astype(np.int64)
    parts[rest] = np.where(left > 0, left + len(poles), 0)
    return parts, links


def _middle(stem: Stem, xyz: NDArray[np.float64]) -> int:
    """Return the voxel of a stem that is nearest to its middle."""
    height = 0.5 * (stem.low + stem.high)
    place = np.append(stem.base + stem.slope * height, height)
    return int(((xyz - place) ** 2).sum(axis=1).argmin())


def _shaft(stem: Stem, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which voxels are a pole's own: all close to its axis, and where a bin is at its foot its thickness alone."""
    distance, height = stem.distance(xyz), xyz[:, 2] - stem.low
    near = np.flatnonzero((distance <= _AROUND) & (xyz[:, 2] <= stem.high + SLAB))
    slab = np.floor(height[near] / SLAB).astype(np.int64)
    first = int(slab.min())
    slab -= first
    inside = distance[near] <= RADIUS
    own = np.bincount(slab[inside], minlength=int(slab.max()) + 1)
    crowded = np.bincount(slab[~inside], minlength=len(own)) > _CROWD * own
    low = (np.arange(len(own)) + first) * SLAB < _LOW
    above = distance[near[inside & ~(crowded | low)[slab]]]
    radius = float(np.clip(np.median(above) + _MARGIN, *_THICK)) if len(above) else _THICK[0]
    shaft = np.zeros(len(xyz), np.bool_)
    shaft[near] = distance[near] <= np.where((crowded & low)[slab], radius, RADIUS)
    return shaft


def _attach(xyz: NDArray[np.float64], parts: NDArray[np.int64], poles: list[Stem]) -> None:
    """Give poles their arms, lamps and plates: small pieces that hang on nothing else, in place."""
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        return
    piece = cluster(np.ascontiguousarray(xyz[rest]), tolerance=0.25).astype(np.int64)
    _, width, size = measure_sections(xyz[rest], piece)
    low = np.full(len(size), np.inf)
    np.minimum.at(low, piece, xyz[rest, 2])
    small = (size <= _FIXTURE) & (width <= _REACH)
    for number, stem in enumerate(poles, start=1):
        touching = np.zeros(len(size), np.bool_)
        close = (stem.distance(xyz[rest]) <= RADIUS + 0.25) & (xyz[rest, 2] <= stem.high + 0.5)
        touching[piece[close]] = True
        own = touching & small & (low >= stem.low + _ABOVE)
        for k in np.flatnonzero(touching & ~small & (low >= stem.low + _ARM[3])):
            own[k] = _is_arm(xyz[rest[piece == k]])
        target = number
        for first in np.unique(parts[rest[own[piece]]]).tolist():
            # Two posts that carry one plate between them are one sign.
            if 0 < first != target and _level(poles[first - 1], stem):
                parts[parts == target] = first
                target = first
        parts[rest[own[piece] & (parts[rest] == 0)]] = target


def _is_arm(places: NDArray[np.float64]) -> bool:
    """Tell whether a piece is the long arm of a mast: no crown is so narrow and so flat."""
    flat = places[:, :2] - places[:, :2].mean(axis=0)
    along = np.linalg.eigh(flat.T @ flat)[1]
    width, length = np.ptp(flat @ along, axis=0)
    return bool(length <= _ARM[0] and width <= _ARM[1] and np.ptp(places[:, 2]) <= _ARM[2])


def _level(one: Stem, other: Stem) -> bool:
    """Tell whether two poles are as high as each other, and close."""
    height = 0.5 * (one.low + one.high)
    step = one.base + one.slope * height - other.base - other.slope * height
    return bool(np.hypot(*step) <= _POSTS and abs(one.high - other.high) <= _LEVEL)
