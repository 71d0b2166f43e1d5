"""Poles taken out of the clusters that they share with plants and with what leans on them.

A cut along the weights of equation 19 does not part a thin pole from a crown around it: the side of few voxels has most
of its weight across the cut. A pole is therefore looked for by its shape: a narrow upright line that stands free over
some of its length and goes on, denser than what is around it, through the crown. A trunk looks the same up to where the
crown begins; it is told from a pole by the crown, which lies around it on all sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

_SLAB = 0.2  # height of a section, metres
_STEP = 0.15  # voxels of one section are this close, metres
_WIDTH = 0.5  # the widest section of a pole, metres
_FREE, _STRAY = 0.4, 1.34  # metres around a section that stands free, and voxels there over its own
_SHIFT = 0.12  # of the middles of a pole's sections from one to the next, metres
_LEAN, _CURVE = 0.15, 0.05  # slope of its axis, and deviation from it, metres
_CORE, _RING = 0.15, 0.45  # radii within which a pole is denser than around it, metres
_DENSER = 3.0
_GAP = 4  # sections that may be hidden inside a crown
_RADIUS = 0.22  # of what belongs to a pole around its axis, metres
_HEIGHT = 1.7  # the lowest pole that is taken out, metres
_AROUND = 2.0  # of an axis, where a crown is looked for, metres
_CROWN = 300  # voxels that make a crown
_JOINED = 0.25  # voxels of one crown are this close, metres
_FOOT, _BESIDE, _STEM = 0.7, 0.3, 1.2  # of a stem that was not found: height of its foot, distance, width, metres
_ASIDE = 0.7  # a crown whose middle is farther from an axis grows on another stem, metres
_FIXTURE, _REACH, _ABOVE = 200, 4.0, 1.0  # voxels and width of lamps, arms and plates, and their least height, metres
_APART = 0.5  # what is left of a cluster and lies farther apart falls into parts, metres
_POSTS, _LEVEL = 2.5, 0.5  # the farthest two posts of one plate, and the most that their tops differ, metres


@dataclass(frozen=True)
class _Stem:
    """An upright line: x, y = base + slope * z, from the height `low` to `high`."""

    base: NDArray[np.float64]
    slope: NDArray[np.float64]
    low: float
    high: float

    def away(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        return xyz[:, :2] - self.base - xyz[:, 2:] * self.slope

    def distance(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.hypot(*self.away(xyz).T)


def separate_poles(
    places: NDArray[np.float64], counts: NDArray[np.int64], clusters: NDArray[np.int32], *, free_length: float
) -> NDArray[np.int32]:
    """Take poles out of clusters that hold other things too.

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
    ndarray of int32, shape (v,)
        The same clusters, and new numbers for the parts of those that held poles.
    """
    stems = _find_stems(places, clusters, free_length)
    out, last = clusters.copy(), int(clusters.max(initial=-1))
    if not stems:
        return out
    order = np.argsort(clusters, kind="stable")
    for number, found in stems.items():
        first, stop = np.searchsorted(clusters[order], [number, number + 1])
        members = order[first:stop]
        parts = _split(places[members], counts[members], found)
        out[members] = np.where(parts > 0, parts + last, number)
        last += int(parts.max())
    return out


def _find_stems(places: NDArray[np.float64], clusters: NDArray[np.int32], free_length: float) -> dict[int, list[_Stem]]:
    """Return the lines of narrow sections that stand free, by cluster."""
    tall = np.full(int(clusters.max(initial=-1)) + 1, -np.inf)
    low = -tall
    np.maximum.at(tall, clusters, places[:, 2])
    np.minimum.at(low, clusters, places[:, 2])
    rows = np.flatnonzero((tall - low >= _HEIGHT)[clusters])
    if len(rows) == 0:
        return {}
    origin = places.min(axis=0)
    xyz = places[rows] - origin
    slab = np.floor(xyz[:, 2] / _SLAB)
    flat = np.column_stack([xyz[:, :2], 10.0 * slab])  # sections of different heights are far apart
    section = _combined(cluster(flat, tolerance=_STEP), clusters[rows])
    middle, width, size = _sections(xyz, section)
    first = np.unique(section, return_index=True)[1]
    narrow = np.flatnonzero(width <= _WIDTH)
    near = cKDTree(flat).query_ball_point(
        np.column_stack([middle[narrow, :2], 10.0 * slab[first[narrow]]]), _FREE, return_length=True
    )
    free = narrow[near <= _STRAY * size[narrow]]
    owner = clusters[rows[first[free]]]
    found: dict[int, list[_Stem]] = {}
    for chain in _chains(middle[free], slab[first[free]], owner):
        stem = _fit(middle[free[chain]], origin, free_length)
        if stem is not None:
            found.setdefault(int(owner[chain[0]]), []).append(stem)
    return found


def _combined(a: NDArray[np.int32], b: NDArray[np.int32]) -> NDArray[np.int64]:
    """Number the pairs of two numbers."""
    return np.unique(a.astype(np.int64) * (int(b.max()) + 1) + b, return_inverse=True)[1].astype(np.int64)


def _sections(
    xyz: NDArray[np.float64], section: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the middle of each section, its width and its number of voxels."""
    n = int(section.max()) + 1
    size = np.bincount(section, minlength=n)
    middle = np.column_stack([np.bincount(section, xyz[:, axis], minlength=n) / size for axis in range(3)])
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    np.minimum.at(low, section, xyz[:, :2])
    np.maximum.at(high, section, xyz[:, :2])
    return middle, (high - low).max(axis=1), size


def _chains(
    middle: NDArray[np.float64], slab: NDArray[np.float64], owner: NDArray[np.int32]
) -> list[NDArray[np.int64]]:
    """Return the sections of each line: those of one cluster that lie above each other with at most one left out."""
    if len(middle) < 2:
        return []
    level = np.column_stack([middle[:, :2], _SLAB * slab])
    pairs = cKDTree(level).query_pairs(np.hypot(_SHIFT, 2.1 * _SLAB), output_type="ndarray")
    step = np.hypot(*(level[pairs[:, 0], :2] - level[pairs[:, 1], :2]).T)
    good = (step <= _SHIFT) & (slab[pairs[:, 0]] != slab[pairs[:, 1]]) & (owner[pairs[:, 0]] == owner[pairs[:, 1]])
    label = connected_components(pairs[good], n_nodes=len(middle))
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _fit(middle: NDArray[np.float64], origin: NDArray[np.float64], free_length: float) -> _Stem | None:
    """Fit a straight upright line to sections; None where they are none, or it is short."""
    low, high = float(middle[:, 2].min()), float(middle[:, 2].max())
    if len(middle) < 4 or high - low < free_length - _SLAB:
        return None
    design = np.column_stack([np.ones(len(middle)), middle[:, 2]])
    line, *_ = np.linalg.lstsq(design, middle[:, :2], rcond=None)
    off = np.hypot(*(middle[:, :2] - design @ line).T)
    if np.hypot(*line[1]) > _LEAN or np.sqrt((off**2).mean()) > _CURVE:
        return None
    base = line[0] + origin[:2] - line[1] * origin[2]
    return _Stem(base, line[1], low + float(origin[2]), high + float(origin[2]))


def _split(xyz: NDArray[np.float64], counts: NDArray[np.int64], stems: list[_Stem]) -> NDArray[np.int64]:
    """Return the part of each voxel of a cluster: 0 for what stays, 1, 2, ... for poles and what they held together."""
    stems = _merged([_extended(stem, xyz, counts) for stem in _merged(stems)])
    stems = [stem for stem in stems if stem.high - stem.low >= _HEIGHT]
    parts = np.zeros(len(xyz), np.int64)
    poles = _without_crown(xyz, stems)
    if not poles:
        return parts
    for number, stem in enumerate(poles, start=1):
        parts[(stem.distance(xyz) <= _RADIUS) & (xyz[:, 2] <= stem.high + _SLAB) & (parts == 0)] = number
    _attach(xyz, parts, poles)
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        # The whole cluster is poles: the first of them keeps the number.
        return np.maximum(parts - 1, 0)
    left = cluster(np.ascontiguousarray(xyz[rest]), tolerance=_APART).astype(np.int64)
    parts[rest] = np.where(left > 0, left + len(poles), 0)
    return parts


def _extended(stem: _Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> _Stem:
    """Follow a line up while points crowd along it, and down to its foot."""
    distance = stem.distance(xyz)
    near = np.flatnonzero(distance <= _RING)
    slab = np.floor((xyz[near, 2] - stem.low) / _SLAB).astype(np.int64)
    lowest = int(slab.min())
    core = distance[near] <= _CORE
    inner = np.bincount(slab[core] - lowest, counts[near][core], minlength=int(slab.max()) - lowest + 1)
    outer = np.bincount(slab[~core] - lowest, counts[near][~core], minlength=len(inner))
    area = (_RING / _CORE) ** 2 - 1.0
    crowded = (inner > 0) & (inner >= _DENSER * outer[: len(inner)] / area)
    top = int((stem.high - stem.low) / _SLAB) - lowest
    while crowded[top + 1 : top + 1 + _GAP].any():
        top += 1 + int(np.argmax(crowded[top + 1 : top + 1 + _GAP]))
    foot = float(xyz[near[core], 2].min()) if core.any() else stem.low
    return _Stem(stem.base, stem.slope, min(foot, stem.low), max(stem.high, stem.low + (top + lowest + 1) * _SLAB))


def _merged(stems: list[_Stem]) -> list[_Stem]:
    """Join the lines that are one: below a crown and above it, or along a trunk that is bent."""
    found: list[_Stem] = []
    for stem in sorted(stems, key=lambda one: (one.low - one.high, one.base[0], one.base[1])):
        for k, other in enumerate(found):
            # In the middle of the heights that both have, or of the gap between them: lines of a bent trunk meet there.
            height = 0.5 * (max(stem.low, other.low) + min(stem.high, other.high))
            place = np.append(stem.base + stem.slope * height, height)[None]
            if other.distance(place)[0] <= 2 * _CORE:
                found[k] = _Stem(other.base, other.slope, min(stem.low, other.low), max(stem.high, other.high))
                break
        else:
            found.append(stem)
    return found


def _without_crown(xyz: NDArray[np.float64], stems: list[_Stem]) -> list[_Stem]:
    """Return the lines that no crown grows on: there is little around, or on one side, or it stands on another stem."""
    if not stems:
        return []
    rest = np.ones(len(xyz), np.bool_)
    for stem in stems:
        rest &= (stem.distance(xyz) > _RADIUS) | (xyz[:, 2] > stem.high + _SLAB)
    places = xyz[rest]
    piece = cluster(np.ascontiguousarray(places), tolerance=_JOINED)
    size, aside = np.zeros(len(stems), np.int64), np.zeros(len(stems))
    hidden = np.zeros(len(stems), np.bool_)
    for k, stem in enumerate(stems):
        away = stem.away(places)
        here = (np.hypot(*away.T) <= _AROUND) & (places[:, 2] >= stem.low + 0.4 * (stem.high - stem.low))
        size[k] = here.sum()
        aside[k] = np.hypot(*away[here].mean(axis=0)) if here.any() else np.inf
        hidden[k] = here.any() and _stands(away, places[:, 2] - stem.low, piece == np.bincount(piece[here]).argmax())
    foot = np.array([stem.base + stem.slope * stem.low for stem in stems])
    poles = []
    for k, stem in enumerate(stems):
        apart = np.hypot(*(foot - foot[k]).T)
        rivals = (apart <= _AROUND) & (size >= _CROWN)
        # A crown that reaches over from a stem farther off lies aside of this one, and around that one.
        rivals |= (apart <= 1.5 * _AROUND) & (size >= _CROWN) & (aside < 0.5 * aside[k])
        carries = size[k] >= _CROWN and aside[k] < _ASIDE and aside[k] <= aside[rivals].min() and not hidden[k]
        if not carries:
            poles.append(stem)
    return poles


def _stands(away: NDArray[np.float64], height: NDArray[np.float64], crown: NDArray[np.bool_]) -> bool:
    """Tell whether a crown comes down to the ground beside a line: then a stem that was not found carries it."""
    near = crown & (np.hypot(*away.T) <= _AROUND)
    if not near.any() or height[near].min() > _FOOT:
        return False
    foot = away[near & (height <= height[near].min() + _FOOT)]
    # A wall or a hedge that the crown touches is no stem.
    return bool(np.hypot(*foot.mean(axis=0)) >= _BESIDE and np.ptp(foot, axis=0).max() <= _STEM)


def _attach(xyz: NDArray[np.float64], parts: NDArray[np.int64], poles: list[_Stem]) -> None:
    """Give poles their arms, lamps and plates: small pieces that hang on nothing else, in place."""
    rest = np.flatnonzero(parts == 0)
    if len(rest) == 0:
        return
    piece = cluster(np.ascontiguousarray(xyz[rest]), tolerance=0.25).astype(np.int64)
    _, width, size = _sections(xyz[rest], piece)
    low = np.full(len(size), np.inf)
    np.minimum.at(low, piece, xyz[rest, 2])
    for number, stem in enumerate(poles, start=1):
        touching = np.zeros(len(size), np.bool_)
        close = (stem.distance(xyz[rest]) <= _RADIUS + 0.25) & (xyz[rest, 2] <= stem.high + 0.5)
        touching[piece[close]] = True
        own = touching & (size <= _FIXTURE) & (width <= _REACH) & (low >= stem.low + _ABOVE)
        target = number
        for first in np.unique(parts[rest[own[piece]]]).tolist():
            # Two posts that carry one plate between them are one sign.
            if 0 < first != target and _level(poles[first - 1], stem):
                parts[parts == target] = first
                target = first
        parts[rest[own[piece] & (parts[rest] == 0)]] = target


def _level(one: _Stem, other: _Stem) -> bool:
    """Tell whether two poles are as high as each other, and close."""
    height = 0.5 * (one.low + one.high)
    step = one.base + one.slope * height - other.base - other.slope * height
    return bool(np.hypot(*step) <= _POSTS and abs(one.high - other.high) <= _LEVEL)
