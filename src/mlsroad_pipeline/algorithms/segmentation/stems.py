"""Upright lines among voxels: the stems of poles and of trunks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

SLAB = 0.2
"""Height of a section, metres."""

RADIUS = 0.22
"""Of what belongs to a stem around its axis, metres."""

HEIGHT = 1.7
"""The lowest stem that is looked at, metres."""

_STEP = 0.15  # voxels of one section are this close, metres
_WIDTH = 0.5  # the widest section of a stem, metres
_FREE, _STRAY = 0.4, 1.34  # metres around a section that stands free, and voxels there over its own
_SHIFT = 0.12  # of the middles of a stem's sections from one to the next, metres
_LEAN, _CURVE = 0.15, 0.05  # slope of its axis, and deviation from it, metres
_CORE, _RING = 0.15, 0.45  # radii within which a stem is denser than around it, metres
_DENSER = 3.0
_SIGN, _SHORT = 5.0, 0.6  # height of a sign with what leans on it, and length over which its post stands free, metres
_GAP = 4  # sections that may be hidden inside a crown


@dataclass(frozen=True)
class Stem:
    """An upright line: x, y = base + slope * z, from the height `low` to `high`.

    Parameters
    ----------
    base : ndarray of float64, shape (2,)
        Its horizontal place at height 0, metres.
    slope : ndarray of float64, shape (2,)
        How far it moves per metre of height.
    low, high : float
        Heights of its ends, metres.
    """

    base: NDArray[np.float64]
    slope: NDArray[np.float64]
    low: float
    high: float

    def away(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far places lie off the line.

        Parameters
        ----------
        xyz : ndarray of float64, shape (n, 3)
            Places, metres, z up.

        Returns
        -------
        ndarray of float64, shape (n, 2)
            Horizontal offsets at the places' own heights, metres.
        """
        return xyz[:, :2] - self.base - xyz[:, 2:] * self.slope

    def distance(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the horizontal distance of places from the line, which may be prolonged.

        Parameters
        ----------
        xyz : ndarray of float64, shape (n, 3)
            Places, metres, z up.

        Returns
        -------
        ndarray of float64, shape (n,)
            Distances, metres.
        """
        return _distances(xyz, self.base, self.slope)


@njit(cache=True, nogil=True)
def _distances(xyz: NDArray[np.float64], base: NDArray[np.float64], slope: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far places lie off a line: every stem asks it of all voxels of its cluster, which may be a wood."""
    out = np.empty(len(xyz))
    for i in range(len(xyz)):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        out[i] = np.hypot(x - base[0] - z * slope[0], y - base[1] - z * slope[1])
    return out


def find_stems(places: NDArray[np.float64], clusters: NDArray[np.int32], free_length: float) -> dict[int, list[Stem]]:
    """Return the lines of narrow sections that stand free.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 3)
        Voxels of about 0.1 m, metres, z up.
    clusters : ndarray of int32, shape (v,)
        Cluster of each, 0, 1, ...
    free_length : float
        Least length of a line, metres; in a cluster no higher than a sign 0.6 is enough. Larger finds fewer.

    Returns
    -------
    dict of int to list of Stem
        The lines of each cluster that has any.
    """
    tall = np.full(int(clusters.max(initial=-1)) + 1, -np.inf)
    low = -tall
    np.maximum.at(tall, clusters, places[:, 2])
    np.minimum.at(low, clusters, places[:, 2])
    rows = np.flatnonzero((tall - low >= HEIGHT)[clusters])
    if len(rows) == 0:
        return {}
    origin = places.min(axis=0)
    xyz = places[rows] - origin
    slab = np.floor(xyz[:, 2] / SLAB)
    flat = np.column_stack([xyz[:, :2], 10.0 * slab])  # sections of different heights are far apart
    section = _combined(cluster(flat, tolerance=_STEP), clusters[rows])
    middle, width, size = measure_sections(xyz, section)
    first = np.unique(section, return_index=True)[1]
    narrow = np.flatnonzero(width <= _WIDTH)
    near = cKDTree(flat).query_ball_point(
        np.column_stack([middle[narrow, :2], 10.0 * slab[first[narrow]]]), _FREE, return_length=True
    )
    free = narrow[near <= _STRAY * size[narrow]]
    owner = clusters[rows[first[free]]]
    found: dict[int, list[Stem]] = {}
    for chain in _chains(middle[free], slab[first[free]], owner):
        number = int(owner[chain[0]])
        # Between a bin at the foot of a sign and its plate the post is seen over a short length alone.
        sign = tall[number] - low[number] <= _SIGN
        stem = _fit(middle[free[chain]], origin, min(free_length, _SHORT) if sign else free_length)
        if stem is not None:
            found.setdefault(number, []).append(stem)
    return found


def _combined(a: NDArray[np.int32], b: NDArray[np.int32]) -> NDArray[np.int64]:
    """Number the pairs of two numbers."""
    return np.unique(a.astype(np.int64) * (int(b.max()) + 1) + b, return_inverse=True)[1].astype(np.int64)


def measure_sections(
    xyz: NDArray[np.float64], section: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Measure sections.

    Parameters
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Places, metres.
    section : ndarray of int64, shape (n,)
        Section of each, 0, 1, ...

    Returns
    -------
    middle : ndarray of float64, shape (s, 3)
        Mean of each section's places, metres.
    width : ndarray of float64, shape (s,)
        The longer of its extents along x and y, metres.
    size : ndarray of int64, shape (s,)
        Its number of places.
    """
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
    level = np.column_stack([middle[:, :2], SLAB * slab])
    pairs = cKDTree(level).query_pairs(np.hypot(_SHIFT, 2.1 * SLAB), output_type="ndarray")
    step = np.hypot(*(level[pairs[:, 0], :2] - level[pairs[:, 1], :2]).T)
    good = (step <= _SHIFT) & (slab[pairs[:, 0]] != slab[pairs[:, 1]]) & (owner[pairs[:, 0]] == owner[pairs[:, 1]])
    label = connected_components(pairs[good], n_nodes=len(middle))
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _fit(middle: NDArray[np.float64], origin: NDArray[np.float64], free_length: float) -> Stem | None:
    """Fit a straight upright line to sections; None where they are none, or it is short."""
    low, high = float(middle[:, 2].min()), float(middle[:, 2].max())
    if len(middle) < 3 or high - low < free_length - SLAB:
        return None
    design = np.column_stack([np.ones(len(middle)), middle[:, 2]])
    line, *_ = np.linalg.lstsq(design, middle[:, :2], rcond=None)
    off = np.hypot(*(middle[:, :2] - design @ line).T)
    if np.hypot(*line[1]) > _LEAN or np.sqrt((off**2).mean()) > _CURVE:
        return None
    base = line[0] + origin[:2] - line[1] * origin[2]
    return Stem(base, line[1], low + float(origin[2]), high + float(origin[2]))


def extended(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> Stem:
    """Follow a line up while points crowd along it, and down to its foot.

    Parameters
    ----------
    stem : Stem
        The line.
    xyz : ndarray of float64, shape (v, 3)
        Voxels of its cluster, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.

    Returns
    -------
    Stem
        The same line, at least as long.
    """
    distance = stem.distance(xyz)
    near = np.flatnonzero(distance <= _RING)
    slab = np.floor((xyz[near, 2] - stem.low) / SLAB).astype(np.int64)
    lowest = int(slab.min())
    core = distance[near] <= _CORE
    inner = np.bincount(slab[core] - lowest, counts[near][core], minlength=int(slab.max()) - lowest + 1)
    outer = np.bincount(slab[~core] - lowest, counts[near][~core], minlength=len(inner))
    area = (_RING / _CORE) ** 2 - 1.0
    crowded = (inner > 0) & (inner >= _DENSER * outer[: len(inner)] / area)
    top = int((stem.high - stem.low) / SLAB) - lowest
    while crowded[top + 1 : top + 1 + _GAP].any():
        top += 1 + int(np.argmax(crowded[top + 1 : top + 1 + _GAP]))
    foot = float(xyz[near[core], 2].min()) if core.any() else stem.low
    return Stem(stem.base, stem.slope, min(foot, stem.low), max(stem.high, stem.low + (top + lowest + 1) * SLAB))


def merged(stems: list[Stem]) -> list[Stem]:
    """Join the lines that are one: below a crown and above it, or along a trunk that is bent.

    Parameters
    ----------
    stems : list of Stem
        Lines of one cluster.

    Returns
    -------
    list of Stem
        The longest of each, from the lowest end to the highest.
    """
    found: list[Stem] = []
    for stem in sorted(stems, key=lambda one: (one.low - one.high, one.base[0], one.base[1])):
        for k, other in enumerate(found):
            # In the middle of the heights that both have, or of the gap between them: lines of a bent trunk meet there.
            height = 0.5 * (max(stem.low, other.low) + min(stem.high, other.high))
            place = np.append(stem.base + stem.slope * height, height)[None]
            if other.distance(place)[0] <= 2 * _CORE:
                found[k] = Stem(other.base, other.slope, min(stem.low, other.low), max(stem.high, other.high))
                break
        else:
            found.append(stem)
    return found


def whole_stems(stems: list[Stem], xyz: NDArray[np.float64], counts: NDArray[np.int64]) -> list[Stem]:
    """Join the lines of a cluster that are one, follow each to its ends, and leave out what is low.

    Parameters
    ----------
    stems : list of Stem
        Lines of one cluster.
    xyz : ndarray of float64, shape (v, 3)
        Voxels of it, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.

    Returns
    -------
    list of Stem
        The stems, `HEIGHT` or more high.
    """
    found = merged([extended(stem, xyz, counts) for stem in merged(stems)])
    return [stem for stem in found if stem.high - stem.low >= HEIGHT]
