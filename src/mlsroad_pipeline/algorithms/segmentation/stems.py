"""Detection of stems: upright lines of poles and trunks among voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.pole_parameters import POLE_REFINEMENT, PoleRefinementParameters


@dataclass(frozen=True)
class Stem:
    """An upright line: x, y = base + slope * z, from the height `low` to `high`.

    Parameters
    ----------
    base : ndarray of float64, shape (2,)
        Its horizontal position at height 0, metres.
    slope : ndarray of float64, shape (2,)
        Horizontal displacement per metre of height.
    low, high : float
        Heights of its ends, metres.
    """

    base: NDArray[np.float64]
    slope: NDArray[np.float64]
    low: float
    high: float

    def at(self, height: float) -> NDArray[np.float64]:
        """Return the horizontal position of the line at a height, metres, shape (2,)."""
        return self.base + self.slope * height

    def away(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the horizontal offsets of places from the line.

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
        """Return the horizontal distances of places from the line, extended beyond its ends.

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
    """Return the distances of places from a line; compiled, as it runs for every stem over all voxels of a cluster."""
    out = np.empty(len(xyz))
    for i in range(len(xyz)):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        out[i] = np.hypot(x - base[0] - z * slope[0], y - base[1] - z * slope[1])
    return out


def find_stems(
    places: NDArray[np.float64],
    clusters: NDArray[np.int32],
    free_length: float,
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
) -> dict[int, list[Stem]]:
    """Find lines of narrow sections that stand free.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 3)
        Voxels of about 0.1 m, metres, z up.
    clusters : ndarray of int32, shape (v,)
        Cluster of each, 0, 1, ...
    free_length : float
        Minimum length of a line, metres; in clusters up to `sign_height` at most `sign_free_length`. Larger finds
        fewer.
    refinement : PoleRefinementParameters
        Limits of sections and lines.

    Returns
    -------
    dict of int to list of Stem
        The lines of each cluster that has any.
    """
    p = refinement
    tall = np.full(int(clusters.max(initial=-1)) + 1, -np.inf)
    low = -tall
    np.maximum.at(tall, clusters, places[:, 2])
    np.minimum.at(low, clusters, places[:, 2])
    rows = np.flatnonzero((tall - low >= p.stem_min_height)[clusters])
    if len(rows) == 0:
        return {}
    origin = places.min(axis=0)
    xyz = places[rows] - origin
    slab = np.floor(xyz[:, 2] / p.section_height)
    flat = np.column_stack([xyz[:, :2], 10.0 * slab])  # sections of different heights are far apart
    section = _combined(cluster(flat, tolerance=p.section_tolerance), clusters[rows])
    middle, width, size = measure_sections(xyz, section)
    first = np.unique(section, return_index=True)[1]
    narrow = np.flatnonzero(width <= p.section_max_width)
    near = cKDTree(flat).query_ball_point(
        np.column_stack([middle[narrow, :2], 10.0 * slab[first[narrow]]]), p.clearance_radius, return_length=True
    )
    free = narrow[near <= p.clearance_ratio * size[narrow]]
    owner = clusters[rows[first[free]]]
    stems: dict[int, list[Stem]] = {}
    for chain in _chains(middle[free], slab[first[free]], owner, p):
        number = int(owner[chain[0]])
        # Between a bin at the foot of a sign and its plate only a short length of the post is visible.
        sign = tall[number] - low[number] <= p.sign_height
        stem = _fit(middle[free[chain]], origin, min(free_length, p.sign_free_length) if sign else free_length, p)
        if stem is not None:
            stems.setdefault(number, []).append(stem)
    return stems


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
    middle: NDArray[np.float64], slab: NDArray[np.float64], owner: NDArray[np.int32], p: PoleRefinementParameters
) -> list[NDArray[np.int64]]:
    """Return the sections of each line: sections of one cluster above each other, with gaps of at most one section."""
    if len(middle) < 2:
        return []
    level = np.column_stack([middle[:, :2], p.section_height * slab])
    pairs = cKDTree(level).query_pairs(np.hypot(p.max_shift, 2.1 * p.section_height), output_type="ndarray")
    step = np.hypot(*(level[pairs[:, 0], :2] - level[pairs[:, 1], :2]).T)
    good = (step <= p.max_shift) & (slab[pairs[:, 0]] != slab[pairs[:, 1]]) & (owner[pairs[:, 0]] == owner[pairs[:, 1]])
    label = connected_components(pairs[good], n_nodes=len(middle))
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _fit(
    middle: NDArray[np.float64], origin: NDArray[np.float64], free_length: float, p: PoleRefinementParameters
) -> Stem | None:
    """Fit an upright line to sections; None where it is too short, too steeply inclined or not straight."""
    low, high = float(middle[:, 2].min()), float(middle[:, 2].max())
    if len(middle) < 3 or high - low < free_length - p.section_height:
        return None
    design = np.column_stack([np.ones(len(middle)), middle[:, 2]])
    line, *_ = np.linalg.lstsq(design, middle[:, :2], rcond=None)
    off = np.hypot(*(middle[:, :2] - design @ line).T)
    if np.hypot(*line[1]) > p.max_slope or np.sqrt((off**2).mean()) > p.max_residual:
        return None
    base = line[0] + origin[:2] - line[1] * origin[2]
    return Stem(base, line[1], low + float(origin[2]), high + float(origin[2]))


def _extended(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64], p: PoleRefinementParameters) -> Stem:
    """Extend a stem upwards while points are denser in its core than around it, and downwards to its foot."""
    distance = stem.distance(xyz)
    near = np.flatnonzero(distance <= p.ring_radius)
    slab = np.floor((xyz[near, 2] - stem.low) / p.section_height).astype(np.int64)
    lowest = int(slab.min())
    core = distance[near] <= p.core_radius
    inner = np.bincount(slab[core] - lowest, counts[near][core], minlength=int(slab.max()) - lowest + 1)
    outer = np.bincount(slab[~core] - lowest, counts[near][~core], minlength=len(inner))
    area = (p.ring_radius / p.core_radius) ** 2 - 1.0
    dense = (inner > 0) & (inner >= p.core_density_ratio * outer[: len(inner)] / area)
    top = int((stem.high - stem.low) / p.section_height) - lowest
    while dense[top + 1 : top + 1 + p.max_hidden_sections].any():
        top += 1 + int(np.argmax(dense[top + 1 : top + 1 + p.max_hidden_sections]))
    foot = float(xyz[near[core], 2].min()) if core.any() else stem.low
    high = stem.low + (top + lowest + 1) * p.section_height
    return Stem(stem.base, stem.slope, min(foot, stem.low), max(stem.high, high))


def _merged(stems: list[Stem], p: PoleRefinementParameters) -> list[Stem]:
    """Merge collinear lines, as below and above a crown or along a bent trunk.

    The longest line of each group is kept, from the lowest end to the highest.
    """
    merged: list[Stem] = []
    for stem in sorted(stems, key=lambda one: (one.low - one.high, one.base[0], one.base[1])):
        for k, other in enumerate(merged):
            # In the middle of their common heights, or of the gap between them: lines of a bent trunk meet there.
            height = 0.5 * (max(stem.low, other.low) + min(stem.high, other.high))
            place = np.append(stem.at(height), height)[None]
            if other.distance(place)[0] <= 2 * p.core_radius:
                merged[k] = Stem(other.base, other.slope, min(stem.low, other.low), max(stem.high, other.high))
                break
        else:
            merged.append(stem)
    return merged


def whole_stems(
    stems: list[Stem],
    xyz: NDArray[np.float64],
    counts: NDArray[np.int64],
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
) -> list[Stem]:
    """Merge collinear lines of a cluster, extend each to its ends, and discard short ones.

    Parameters
    ----------
    stems : list of Stem
        Lines of one cluster.
    xyz : ndarray of float64, shape (v, 3)
        Voxels of it, metres, z up.
    counts : ndarray of int64, shape (v,)
        Points in each.
    refinement : PoleRefinementParameters
        Radii and densities along a stem.

    Returns
    -------
    list of Stem
        The stems of at least `stem_min_height`.
    """
    p = refinement
    merged = _merged([_extended(stem, xyz, counts, p) for stem in _merged(stems, p)], p)
    return [stem for stem in merged if stem.high - stem.low >= p.stem_min_height]
