"""Profiles of objects: distribution of voxels over height, distance from the axis, local shape and intensity."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column
from mlsroad_pipeline.algorithms.features.eigen_solver import solve_symmetric

KINDS = 8
"""Number of kinds: vertical, inclined and horizontal lines; vertical, inclined and horizontal planes; neither; and
undefined for too few neighbours."""

_REACH = 2  # neighbourhood in each direction, voxels
_LEAST_VOXELS = 4  # fewest voxels, including the voxel itself
_LINE = 0.9, 0.4  # least vertical component of the direction of a vertical line, and of an inclined one
_PLANE = 0.3, 0.8  # least vertical component of the normal of an inclined plane, and of a horizontal one


def surface_kinds(
    places: NDArray[np.float64], cells: NDArray[np.int64], starts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Classify the local shape around each voxel from the voxels of its object."""
    scatter, counts = _scatter(places, cells, starts)
    values, normals, directions = (np.empty((3, len(places))) for _ in range(3))
    solve_symmetric(scatter, len(places), values, normals, directions)
    long, middle, short = np.sqrt(values)
    dimension = np.argmax([long - middle, middle - short, short], axis=0)
    line = 2 - np.searchsorted(_LINE[::-1], np.abs(directions[2]))
    plane = 3 + np.searchsorted(_PLANE, np.abs(normals[2]))
    kinds = np.choose(dimension, [line, plane, np.full(len(places), 6)])
    return np.where(counts < _LEAST_VOXELS, KINDS - 1, kinds)


@njit(cache=True, nogil=True)
def _scatter(
    places: NDArray[np.float64], cells: NDArray[np.int64], starts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the covariances xx, xy, xz, yy, yz, zz of the voxels around each, (6, v), and their numbers."""
    covariances, counts = np.zeros((6, len(places))), np.zeros(len(places), np.int64)
    sums = np.empty(9)
    for k in range(len(starts) - 1):
        for i in range(starts[k], starts[k + 1]):
            counts[i] = _sum_around(places, cells, starts[k], starts[k + 1], i, sums)
            mean = sums[:3] / counts[i]
            at = 0
            for a in range(3):
                for b in range(a, 3):
                    covariances[at, i] = sums[3 + at] / counts[i] - mean[a] * mean[b]
                    at += 1
    return covariances, counts


@njit(cache=True, nogil=True)
def _sum_around(
    places: NDArray[np.float64], cells: NDArray[np.int64], first: int, stop: int, i: int, sums: NDArray[np.float64]
) -> int:
    """Sum offsets from a voxel, and their products, over the voxels of an object around it; return their number."""
    n = 0
    sums[:] = 0.0
    z, y, x = cells[i]
    for dz in range(-_REACH, _REACH + 1):
        for dy in range(-_REACH, _REACH + 1):
            j = _first_from(cells, first, stop, z + dz, y + dy, x - _REACH)
            while j < stop and cells[j, 0] == z + dz and cells[j, 1] == y + dy and cells[j, 2] <= x + _REACH:
                a, b, c = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], places[j, 2] - places[i, 2]
                sums[0] += a
                sums[1] += b
                sums[2] += c
                sums[3] += a * a
                sums[4] += a * b
                sums[5] += a * c
                sums[6] += b * b
                sums[7] += b * c
                sums[8] += c * c
                n += 1
                j += 1
    return n


@njit(cache=True, nogil=True)
def _first_from(cells: NDArray[np.int64], first: int, stop: int, z: int, y: int, x: int) -> int:
    """Return the first voxel of an object whose cell does not precede (z, y, x), by binary search."""
    while first < stop:
        middle = (first + stop) // 2
        cz, cy, cx = cells[middle, 0], cells[middle, 1], cells[middle, 2]
        if cz < z or (cz == z and (cy < y or (cy == y and cx < x))):
            first = middle + 1
        else:
            stop = middle
    return first


BANDS = 12
"""Bands of equal height between the foot and the top of an object."""

RINGS = (0.08, 0.16, 0.26, 0.4, 0.6, 0.85, 1.2, 1.7, 2.4, 3.5, 5.0, np.inf)
"""Outer radii of rings around an object's axis, metres."""

TONES = 20
"""Equal steps of intensity over [0, 1]."""

N_PLACES = BANDS * len(RINGS)
"""Columns of a profile for positions; those for local shapes follow."""

N_BLIND = N_PLACES + BANDS * KINDS
"""Columns of a profile for positions and local shapes; those for intensities follow."""

N_SHARES = N_BLIND + BANDS * TONES
"""Columns of a profile."""

_VOXEL = 0.1  # edge of the voxels, which make the profile independent of the point density, metres
_LEAST = 0.1  # least height of an object, metres


def measure_profiles(
    xyz: NDArray[np.floating], objects: NDArray[np.integer], *, intensity: ArrayLike | None = None
) -> NDArray[np.float32]:
    """Measure the distribution of each object's voxels over height, distance from its axis, shape and intensity."""
    n = int(objects.max(initial=-1)) + 1
    rows = np.flatnonzero(objects >= 0)
    values = None if intensity is None else check_column(intensity, len(xyz), "intensity")
    if len(rows) == 0:
        return np.zeros((n, N_SHARES), dtype=np.float32)
    bright = np.zeros(len(rows)) if values is None else values[rows].astype(np.float64)
    places, means, owner, cells = _voxels(xyz[rows].astype(np.float64), objects[rows].astype(np.int64), bright)
    starts = np.searchsorted(owner, np.arange(n + 1))
    kinds = surface_kinds(places, cells, starts)
    axes = np.zeros((n, 2))
    for k in np.flatnonzero(np.diff(starts)).tolist():
        axes[k] = np.median(places[starts[k] : starts[k + 1], :2], axis=0)
    shares = _shares(places, kinds, means, owner, axes)
    return shares if values is not None else without_intensities(shares)


def without_intensities(profiles: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return profiles without intensities."""
    blind = profiles.copy()
    blind[:, N_BLIND:] = 0.0
    return blind


def _voxels(
    xyz: NDArray[np.float64], objects: NDArray[np.int64], intensity: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return centroids, mean intensities, objects and cells (z, y, x) of the voxels of each object."""
    cell = np.floor((xyz - xyz.min(axis=0)) / _VOXEL).astype(np.int64)
    span = cell.max(axis=0) + 1
    names = ((objects * span[2] + cell[:, 2]) * span[1] + cell[:, 1]) * span[0] + cell[:, 0]
    voxels, owner, counts = np.unique(names, return_inverse=True, return_counts=True)
    places = np.column_stack([np.bincount(owner, xyz[:, axis]) / counts for axis in range(3)])
    cells = np.column_stack([voxels // (span[0] * span[1]) % span[2], voxels // span[0] % span[1], voxels % span[0]])
    return places, np.bincount(owner, intensity) / counts, voxels // (span[0] * span[1] * span[2]), cells


def _shares(
    places: NDArray[np.float64],
    kinds: NDArray[np.int64],
    intensity: NDArray[np.float64],
    owner: NDArray[np.int64],
    axes: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return the shares of the voxels of each object in the columns of its profile."""
    n = len(axes)
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, owner, places[:, 2])
    np.maximum.at(high, owner, places[:, 2])
    step = np.maximum(high - low, _LEAST) / BANDS
    band = np.minimum(((places[:, 2] - low[owner]) / step[owner]).astype(np.int64), BANDS - 1)
    away = np.hypot(*(places[:, :2] - axes[owner]).T)
    ring = np.searchsorted(RINGS, away, side="right")
    tone = np.clip((intensity * TONES).astype(np.int64), 0, TONES - 1)
    columns = (band * len(RINGS) + ring, N_PLACES + band * KINDS + kinds, N_BLIND + band * TONES + tone)
    counts = sum(np.bincount(owner * N_SHARES + column, minlength=n * N_SHARES) for column in columns)
    sizes = np.maximum(np.bincount(owner, minlength=n), 1)
    return (np.reshape(counts, (n, N_SHARES)) / sizes[:, None]).astype(np.float32)


def profile_similarity(queries: NDArray[np.floating], objects: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the similarity of profiles: sum of minima over sum of maxima, as equation 23 for bags."""
    if queries.shape[1] != objects.shape[1]:
        raise DataError(f"profiles of {queries.shape[1]} and {objects.shape[1]} shares cannot be compared")
    return np.asarray(_jaccard(np.ascontiguousarray(queries, np.float64), np.ascontiguousarray(objects, np.float64)))


@njit(cache=True, nogil=True)
def _jaccard(queries: NDArray[np.float64], objects: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sums of minima over the sums of maxima."""
    out = np.zeros((len(queries), len(objects)))
    totals = objects.sum(axis=1)
    for q in range(len(queries)):
        filled = np.flatnonzero(queries[q])  # most shares are 0
        total = queries[q].sum()
        for b in range(len(objects)):
            least = 0.0
            for k in filled:
                least += min(queries[q, k], objects[b, k])
            most = total + totals[b] - least
            out[q, b] = least / most if most > 0.0 else 0.0
    return out
