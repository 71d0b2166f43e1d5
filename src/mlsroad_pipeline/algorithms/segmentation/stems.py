"""Detection of stems: upright lines of poles and trunks among voxels of about 0.1 m. Lengths in metres, z up."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster, number_pairs

# Geometric limits set by hand; none is in Yu et al. 2016.
STEM_RADIUS = 0.22  # m, voxels this close to the axis belong to a stem
_MIN_HEIGHT = 1.7  # m, shorter stems are discarded
_MAX_WIDTH = 0.5  # m, largest horizontal extent of a section; larger accepts wider stems
_CLEARANCE_RADIUS = 0.4  # m, a section stands free where few voxels beside its own lie within this radius
_CLEARANCE_RATIO = 1.34  # voxels within that radius per voxel of the section; larger accepts what leans on a stem
_MAX_SLOPE = 0.15  # horizontal displacement per metre of height; larger accepts leaning stems
_CORE_RADIUS, _RING_RADIUS = 0.15, 0.45  # m, the densities within and between these radii are compared
_CORE_DENSITY_RATIO = 3.0  # a stem continues where its core is this much denser; larger ends stems earlier in crowns
_MAX_HIDDEN_SECTIONS = 4  # sections above the end that are searched for its continuation
_SIGN_HEIGHT, _SIGN_FREE_LENGTH = 5.0, 0.6  # m, between a bin and the plate only this length of a sign's post is free


@dataclass(frozen=True)
class StemLimits:
    """Limits of the sections of a stem; sparse scans need wider ones."""

    section_height: float = 0.2  # m, higher sections hold more points and follow bends less closely
    section_tolerance: float = 0.15  # m, distance between voxels of one section
    max_shift: float = 0.12  # m, largest horizontal step from one section to the next
    max_residual: float = 0.05  # m, largest root mean square distance of the sections from the axis


DENSE = StemLimits()
"""Limits for surveys of thousands of points per square metre."""


@dataclass(frozen=True)
class Stem:
    """An upright line: x, y = base + slope * z, from the height `low` to `high`."""

    base: NDArray[np.float64]  # m, horizontal position at height 0, shape (2,)
    slope: NDArray[np.float64]  # horizontal displacement per metre of height, shape (2,)
    low: float  # m, height of the lower end
    high: float  # m, height of the upper end

    def at(self, height: float) -> NDArray[np.float64]:
        """Return the horizontal position of the line at a height, shape (2,)."""
        return self.base + self.slope * height

    def away(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the horizontal offsets of places from the line at their own heights, shape (n, 2)."""
        return xyz[:, :2] - self.base - xyz[:, 2:] * self.slope

    def distance(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the horizontal distances of places from the line, extended beyond its ends."""
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
    places: NDArray[np.float64], counts: NDArray[np.int64], clusters: NDArray[np.int32], free_length: float,
    limits: StemLimits = DENSE,
) -> Iterator[tuple[int, NDArray[np.int64], list[Stem]]]:  # fmt: skip
    """Yield number, voxels and stems of each cluster of voxels with narrow lines that stand free over `free_length`.

    Lines are merged and extended by the numbers of points in the voxels. Short stems are left out.
    """
    lines = _find_lines(places, clusters, free_length, limits)
    order = np.argsort(clusters, kind="stable")
    starts = np.searchsorted(clusters[order], np.arange(int(clusters.max(initial=-1)) + 2))
    for number, found in lines.items():
        members = order[starts[number] : starts[number + 1]]
        xyz, mass = places[members], counts[members]
        whole = _merged([_extended(stem, xyz, mass, limits.section_height) for stem in _merged(found)])
        yield number, members, [stem for stem in whole if stem.high - stem.low >= _MIN_HEIGHT]


def _find_lines(
    places: NDArray[np.float64], clusters: NDArray[np.int32], free_length: float, limits: StemLimits
) -> dict[int, list[Stem]]:
    """Return the lines of narrow free sections of each cluster that has any; 0.6 m suffice in those up to 5 m high."""
    tall = np.full(int(clusters.max(initial=-1)) + 1, -np.inf)
    low = -tall
    np.maximum.at(tall, clusters, places[:, 2])
    np.minimum.at(low, clusters, places[:, 2])
    rows = np.flatnonzero((tall - low >= _MIN_HEIGHT)[clusters])
    if len(rows) == 0:
        return {}
    origin = places.min(axis=0)
    xyz = places[rows] - origin
    slab = np.floor(xyz[:, 2] / limits.section_height)
    flat = np.column_stack([xyz[:, :2], 10.0 * slab])  # sections of different heights are far apart
    section = number_pairs(cluster(flat, tolerance=limits.section_tolerance), clusters[rows])
    middle, width, size = measure_sections(xyz, section)
    first = np.unique(section, return_index=True)[1]
    narrow = np.flatnonzero(width <= _MAX_WIDTH)
    near = cKDTree(flat).query_ball_point(
        np.column_stack([middle[narrow, :2], 10.0 * slab[first[narrow]]]), _CLEARANCE_RADIUS, return_length=True
    )
    free = narrow[near <= _CLEARANCE_RATIO * size[narrow]]
    owner = clusters[rows[first[free]]]
    stems: dict[int, list[Stem]] = {}
    for chain in _chains(middle[free], slab[first[free]], owner, limits):
        number = int(owner[chain[0]])
        sign = tall[number] - low[number] <= _SIGN_HEIGHT
        stem = _fit(middle[free[chain]], origin, min(free_length, _SIGN_FREE_LENGTH) if sign else free_length, limits)
        if stem is not None:
            stems.setdefault(number, []).append(stem)
    return stems


def measure_sections(
    xyz: NDArray[np.float64], section: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the mean of each section's places, the longer of its extents along x and y, and its number of places."""
    n = int(section.max()) + 1
    size = np.bincount(section, minlength=n)
    sums = [np.bincount(section, xyz[:, axis], minlength=n) for axis in range(3)]
    middle = np.column_stack(sums) / np.maximum(size, 1)[:, None]  # a number without places has the mean 0
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    np.minimum.at(low, section, xyz[:, :2])
    np.maximum.at(high, section, xyz[:, :2])
    return middle, (high - low).max(axis=1), size


def _chains(
    middle: NDArray[np.float64], slab: NDArray[np.float64], owner: NDArray[np.int32], limits: StemLimits
) -> list[NDArray[np.int64]]:
    """Return the sections of each line: sections of one cluster above each other, with gaps of at most one section."""
    if len(middle) < 2:
        return []
    level = np.column_stack([middle[:, :2], limits.section_height * slab])
    reach = np.hypot(limits.max_shift, 2.1 * limits.section_height)
    pairs = cKDTree(level).query_pairs(reach, output_type="ndarray")
    step = np.hypot(*(level[pairs[:, 0], :2] - level[pairs[:, 1], :2]).T)
    apart = slab[pairs[:, 0]] != slab[pairs[:, 1]]
    good = (step <= limits.max_shift) & apart & (owner[pairs[:, 0]] == owner[pairs[:, 1]])
    label = connected_components(pairs[good], n_nodes=len(middle))
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _fit(
    middle: NDArray[np.float64], origin: NDArray[np.float64], free_length: float, limits: StemLimits
) -> Stem | None:
    """Fit an upright line to sections; None where it is too short, too steeply inclined or not straight."""
    low, high = float(middle[:, 2].min()), float(middle[:, 2].max())
    if len(middle) < 3 or high - low < free_length - limits.section_height:
        return None
    design = np.column_stack([np.ones(len(middle)), middle[:, 2]])
    line, *_ = np.linalg.lstsq(design, middle[:, :2], rcond=None)
    off = np.hypot(*(middle[:, :2] - design @ line).T)
    if np.hypot(*line[1]) > _MAX_SLOPE or np.sqrt((off**2).mean()) > limits.max_residual:
        return None
    base = line[0] + origin[:2] - line[1] * origin[2]
    return Stem(base, line[1], low + float(origin[2]), high + float(origin[2]))


def _extended(stem: Stem, xyz: NDArray[np.float64], counts: NDArray[np.int64], height: float) -> Stem:
    """Extend a stem upwards while sections are denser in its core than around it, and downwards to its foot."""
    distance = stem.distance(xyz)
    near = np.flatnonzero(distance <= _RING_RADIUS)
    slab = np.floor((xyz[near, 2] - stem.low) / height).astype(np.int64)
    lowest = int(slab.min())
    core = distance[near] <= _CORE_RADIUS
    inner = np.bincount(slab[core] - lowest, counts[near][core], minlength=int(slab.max()) - lowest + 1)
    outer = np.bincount(slab[~core] - lowest, counts[near][~core], minlength=len(inner))
    area = (_RING_RADIUS / _CORE_RADIUS) ** 2 - 1.0
    dense = (inner > 0) & (inner >= _CORE_DENSITY_RATIO * outer[: len(inner)] / area)
    top = int((stem.high - stem.low) / height) - lowest
    while dense[top + 1 : top + 1 + _MAX_HIDDEN_SECTIONS].any():
        top += 1 + int(np.argmax(dense[top + 1 : top + 1 + _MAX_HIDDEN_SECTIONS]))
    foot = float(xyz[near[core], 2].min()) if core.any() else stem.low
    high = stem.low + (top + lowest + 1) * height
    return Stem(stem.base, stem.slope, min(foot, stem.low), max(stem.high, high))


def _merged(stems: list[Stem]) -> list[Stem]:
    """Merge collinear lines, as below and above a crown; the longest of each group is kept, between the outer ends."""
    merged: list[Stem] = []
    for stem in sorted(stems, key=lambda one: (one.low - one.high, one.base[0], one.base[1])):
        for k, other in enumerate(merged):
            # In the middle of their common heights, or of the gap between them: lines of a bent trunk meet there.
            height = 0.5 * (max(stem.low, other.low) + min(stem.high, other.high))
            place = np.append(stem.at(height), height)[None]
            if other.distance(place)[0] <= 2 * _CORE_RADIUS:
                merged[k] = Stem(other.base, other.slope, min(stem.low, other.low), max(stem.high, other.high))
                break
        else:
            merged.append(stem)
    return merged
