"""Separation of poles from the clusters that they share, and merging of the parts of a pole and of floating parts.

A cut along the weights of equation 19 does not separate a thin pole from a crown around it: the side of few voxels has
most of its weight across the cut. A pole is therefore detected by its shape: a narrow upright line that stands free
over some of its length and continues through the crown, denser than its surroundings. Below the crown a trunk has the
same shape; `find_poles` separates the two by the crown, which surrounds a trunk on all sides.

None of this is in Yu et al. 2016. Voxels have an edge of about 0.1 m; lengths are in metres, z is up.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation.crowned_stems import find_poles
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stems import (
    DENSE,
    STEM_RADIUS,
    Stem,
    find_stems,
    measure_sections,
)

# Limits set by hand: the shaft of a pole.
_SURROUND_RADIUS, _SURROUND_RATIO = 0.45, 0.5  # m; a section is surrounded with more voxels off it, per own voxel
_BASE_ZONE = 1.2  # m above the foot, up to which objects such as bins stand beside a pole
_MIN_RADIUS, _MAX_RADIUS = 0.14, 0.22  # m, range of the radius in surrounded sections of that zone
_RADIUS_MARGIN = 0.05  # m, added to the median distance from the axis above that zone
_REMAINDER_TOLERANCE = 0.5  # m, distance at which a cluster without its poles is clustered again

# Lamps, arms and plates of a pole.
_FIXTURE_VOXELS, _FIXTURE_WIDTH, _FIXTURE_HEIGHT = 200, 4.0, 1.0  # most voxels, largest width, least height above foot
_FIXTURE_TOLERANCE, _OVERHANG = 0.25, 0.5  # m, between voxels and from the stem; height above the top that it touches
_ARM_LENGTH, _ARM_WIDTH, _ARM_HEIGHT = 12.0, 0.9, 1.6  # m, largest arm with signals; crowns are wider or higher
_ARM_MIN_HEIGHT = 3.0  # m, of an arm above the foot
_POST_DISTANCE, _POST_LEVEL = 2.5, 0.5  # m, between two posts of one plate, and between their tops

# Floating parts and gaps.
_FOOT_SHARE = 0.005  # share of a part's voxels below its foot: half a crown may contain a few of an object under it
_END = 0.6  # m, length of the ends of a part that are compared
_NARROW = 0.5  # m, largest width of the end of a pole
_OFF_LINE = 0.2  # m, largest horizontal distance between two ends of one pole
_LOWER_HEIGHT = 1.0  # m, least height of the part below a gap


def separate_poles(
    places: NDArray[np.float64], counts: NDArray[np.int64], clusters: NDArray[np.int32], *, free_length: float
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Take poles that stand free over `free_length` out of clusters of voxels, which get new numbers.

    Also return pairs of voxels on the legs of one gantry, which remains one object wherever it is cut, shape (k, 2).
    """
    out, last = clusters.copy(), int(clusters.max(initial=-1))
    links = [np.zeros((0, 2), np.int64)]
    for number, members, stems in find_stems(places, counts, clusters, free_length):
        parts, legs = _split(places[members], counts[members], stems)
        links.append(members[legs])
        out[members] = np.where(parts > 0, parts + last, number)
        last += int(parts.max())
    return out, np.concatenate(links)


def _split(
    xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[Stem]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the part of each voxel of a cluster, and pairs of voxels on the legs of gantries.

    Part 0 keeps the number of the cluster; 1, 2, ... are poles and what they connected.
    """
    parts = np.zeros(len(xyz), np.int64)
    poles, gantries = find_poles(xyz, counts, stems)
    at = [[_middle(leg, xyz) for leg in legs] for legs in gantries]
    links = np.array([(legs[0], leg) for legs in at for leg in legs[1:]], np.int64).reshape(-1, 2)
    if not poles:
        return parts, links
    for number, stem in enumerate(poles, start=1):
        parts[_shaft(stem, xyz) & (parts == 0)] = number
    _attach(xyz, parts, poles)
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        # The cluster consists of poles alone: the first of them keeps its number.
        return np.maximum(parts - 1, 0), links
    left = cluster(np.ascontiguousarray(xyz[rest]), tolerance=_REMAINDER_TOLERANCE).astype(np.int64)
    parts[rest] = np.where(left > 0, left + len(poles), 0)
    return parts, links


def _middle(stem: Stem, xyz: NDArray[np.float64]) -> int:
    """Return the voxel that is nearest to the middle of a stem."""
    height = 0.5 * (stem.low + stem.high)
    place = np.append(stem.at(height), height)
    return int(((xyz - place) ** 2).sum(axis=1).argmin())


def _shaft(stem: Stem, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which voxels belong to the shaft of a pole.

    These are all close to its axis; in surrounded sections near the foot, as beside a bin, only those within the radius
    measured above.
    """
    distance, height = stem.distance(xyz), xyz[:, 2] - stem.low
    near = np.flatnonzero((distance <= _SURROUND_RADIUS) & (xyz[:, 2] <= stem.high + DENSE.section_height))
    slab = np.floor(height[near] / DENSE.section_height).astype(np.int64)
    first = int(slab.min())
    slab -= first
    inside = distance[near] <= STEM_RADIUS
    own = np.bincount(slab[inside], minlength=int(slab.max()) + 1)
    surrounded = np.bincount(slab[~inside], minlength=len(own)) > _SURROUND_RATIO * own
    low = (np.arange(len(own)) + first) * DENSE.section_height < _BASE_ZONE
    above = distance[near[inside & ~(surrounded | low)[slab]]]
    radius = _MIN_RADIUS
    if len(above):
        radius = float(np.clip(np.median(above) + _RADIUS_MARGIN, _MIN_RADIUS, _MAX_RADIUS))
    shaft = np.zeros(len(xyz), np.bool_)
    shaft[near] = distance[near] <= np.where((surrounded & low)[slab], radius, STEM_RADIUS)
    return shaft


def _attach(xyz: NDArray[np.float64], parts: NDArray[np.int64], poles: list[Stem]) -> None:
    """Assign arms, lamps and plates to poles, in place: small pieces that touch nothing else."""
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        return
    piece = cluster(np.ascontiguousarray(xyz[rest]), tolerance=_FIXTURE_TOLERANCE).astype(np.int64)
    _, width, size = measure_sections(xyz[rest], piece)
    low = np.full(len(size), np.inf)
    np.minimum.at(low, piece, xyz[rest, 2])
    small = (size <= _FIXTURE_VOXELS) & (width <= _FIXTURE_WIDTH)
    for number, stem in enumerate(poles, start=1):
        touching = np.zeros(len(size), np.bool_)
        below_top = xyz[rest, 2] <= stem.high + _OVERHANG
        touching[piece[(stem.distance(xyz[rest]) <= STEM_RADIUS + _FIXTURE_TOLERANCE) & below_top]] = True
        own = touching & small & (low >= stem.low + _FIXTURE_HEIGHT)
        for k in np.flatnonzero(touching & ~small & (low >= stem.low + _ARM_MIN_HEIGHT)):
            own[k] = _is_arm(xyz[rest[piece == k]])
        target = number
        for first in np.unique(parts[rest[own[piece]]]).tolist():
            # Two posts that carry one plate between them are one sign.
            if 0 < first != target and _level(poles[first - 1], stem):
                parts[parts == target] = first
                target = first
        parts[rest[own[piece] & (parts[rest] == 0)]] = target


def _is_arm(places: NDArray[np.float64]) -> bool:
    """Return whether a piece is the long arm of a mast: crowns are wider or higher."""
    flat = places[:, :2] - places[:, :2].mean(axis=0)
    along = np.linalg.eigh(flat.T @ flat)[1]
    width, length = np.ptp(flat @ along, axis=0)
    return bool(length <= _ARM_LENGTH and width <= _ARM_WIDTH and np.ptp(places[:, 2]) <= _ARM_HEIGHT)


def _level(one: Stem, other: Stem) -> bool:
    """Return whether two poles are close and their tops about level."""
    height = 0.5 * (one.low + one.high)
    step = one.base + one.slope * height - other.base - other.slope * height
    return bool(np.hypot(*step) <= _POST_DISTANCE and abs(one.high - other.high) <= _POST_LEVEL)


def rejoin_floating_parts(
    places: NDArray[np.float64], clusters: NDArray[np.int32], parts: NDArray[np.int64], *, foot_height: float,
    reach: float,
) -> NDArray[np.int64]:  # fmt: skip
    """Merge each part without a foot with the part of its cluster that it touches most, and renumber the parts.

    A foot reaches down to within `foot_height` above the lowest place of the cluster; voxels touch within `reach`.
    """
    while len(parts):
        n = int(parts.max()) + 1
        of_part = np.zeros(n, np.int64)
        of_part[parts] = clusters
        low, bottom = _feet(places[:, 2], parts), np.full(int(clusters.max()) + 1, np.inf)
        np.minimum.at(bottom, clusters, places[:, 2])
        floating = np.isfinite(low) & (low - bottom[of_part] > foot_height)
        busy = np.bincount(of_part[floating], minlength=len(bottom)) > 0
        rows = np.flatnonzero(busy[clusters])
        if len(rows) == 0:
            return parts
        pairs = rows[cKDTree(places[rows]).query_pairs(reach, output_type="ndarray")]
        pairs = pairs[(clusters[pairs[:, 0]] == clusters[pairs[:, 1]]) & (parts[pairs[:, 0]] != parts[pairs[:, 1]])]
        sides = np.concatenate([parts[pairs], parts[pairs[:, ::-1]]])
        touch, count = np.unique(sides[floating[sides[:, 0]]], axis=0, return_counts=True)
        order = np.lexsort((touch[:, 1], -count, touch[:, 0]))
        best = order[np.unique(touch[order, 0], return_index=True)[1]]
        parts = connected_components(touch[best], n_nodes=n)[parts].astype(np.int64)
        # Floating parts that touch only each other may touch a part with a foot once they are merged.
        if parts.max() + 1 == n:
            return parts
    return parts


def _feet(heights: NDArray[np.float64], parts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the height of each part's foot; infinity for unused numbers."""
    order = np.lexsort((heights, parts))
    count = np.bincount(parts)
    there = np.flatnonzero(count)
    rows = (np.cumsum(count) - count + (_FOOT_SHARE * count).astype(np.int64))[there]
    feet = np.full(len(count), np.inf)
    feet[there] = heights[order[rows]]
    return feet


def join_stacked_poles(places: NDArray[np.float64], parts: NDArray[np.int64], *, max_gap: float) -> NDArray[np.int64]:
    """Merge the parts of a pole below and above a gap, which was occluded or assigned to a crown, and renumber them."""
    if len(parts) == 0 or max_gap == 0:
        return parts
    top, high, narrow_top = _ends(places, parts, 1.0)
    bottom, low, narrow_bottom = _ends(places, parts, -1.0)
    tall = high - low
    under = np.flatnonzero(narrow_top & (tall >= _LOWER_HEIGHT))
    over = np.flatnonzero(narrow_bottom & (tall >= _END))
    if len(under) == 0 or len(over) == 0:
        return parts
    pairs = []
    for k, near in zip(over, cKDTree(top[under]).query_ball_point(bottom[over], _OFF_LINE), strict=True):
        gap = low[k] - high[under[near]]
        good = (gap > -0.5 * _END) & (gap <= max_gap) & (under[near] != k)
        if good.any():
            pairs.append((k, under[np.asarray(near)[good][np.argmin(gap[good])]]))
    if not pairs:
        return parts
    return connected_components(np.array(pairs, dtype=np.int64), n_nodes=len(high))[parts].astype(np.int64)


def _ends(
    places: NDArray[np.float64], parts: NDArray[np.int64], sign: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return the middle of the upper (1) or lower (-1) end of each part, its height, and whether the end is narrow."""
    height = np.full(int(parts.max()) + 1, -np.inf)
    np.maximum.at(height, parts, sign * places[:, 2])
    rows = np.flatnonzero(sign * places[:, 2] >= height[parts] - _END)
    middle, width, _ = measure_sections(places[rows], parts[rows])
    return middle[:, :2], sign * height, width <= _NARROW
