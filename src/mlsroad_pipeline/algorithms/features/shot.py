"""SHOT descriptor: histograms of normals in a local reference frame (Tombari et al. 2010)."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz

N_AZIMUTH, N_ELEVATION, N_RADIAL, N_COSINE = 8, 2, 2, 11
SIZE = N_AZIMUTH * N_ELEVATION * N_RADIAL * N_COSINE
"""Length of a descriptor: 352, as in Luo et al. 2019, Table 4."""


def local_reference_frame(offsets: ArrayLike, radius: float) -> NDArray[np.float64]:
    """Return the local reference frame of a point.

    The axes are the eigenvectors of the covariance about the centre with weights R - d (Tombari et al. 2010, equation
    1).
    """
    points = np.asarray(offsets, dtype=np.float64)
    weight = np.maximum(radius - np.linalg.norm(points, axis=1), 0.0)
    covariance = (points * weight[:, None]).T @ points / max(float(weight.sum()), 1e-300)
    vectors = np.linalg.eigh(covariance)[1]
    x, z = _towards_most(vectors[:, 2], points), _towards_most(vectors[:, 0], points)
    return np.stack([x, np.cross(z, x), z])


def _towards_most(axis: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    along = points @ axis
    more = int((along > 0).sum()) - int((along < 0).sum())
    return -axis if more < 0 or (more == 0 and along.sum() < 0) else axis


def compute_shot(xyz: ArrayLike, normals: ArrayLike, center: ArrayLike, *, radius: float) -> NDArray[np.float32]:
    """Compute the SHOT descriptor of a point.

    The ball around the centre has 32 sectors: 8 in azimuth, 2 in elevation, 2 in radius. Each has a histogram of 11
    bins over the cosine between its normals and the z axis of the local reference frame.
    """
    check_positive(radius, "radius")
    points = check_xyz(xyz).astype(np.float64) - np.asarray(center, dtype=np.float64)
    directions = check_column(normals, len(points), "normals", width=3).astype(np.float64)
    inside = np.linalg.norm(points, axis=1) <= radius
    points, directions = points[inside], directions[inside]
    frame = local_reference_frame(points, radius)
    usable = np.isfinite(directions).all(axis=1)
    histogram = np.zeros(SIZE)
    cosine = np.clip(directions[usable] @ frame[2], -1.0, 1.0)
    _count(np.ascontiguousarray(points[usable] @ frame.T), cosine, radius, histogram)
    length = float(np.linalg.norm(histogram))
    return (histogram / length if length > 0 else histogram).astype(np.float32)


@njit(cache=True, nogil=True)
def _split(place: float, n_bins: int, circular: bool) -> tuple[int, int, float]:
    """Return the two bins whose centres enclose a position in [0, n_bins], and the share of the second."""
    below = int(np.floor(place - 0.5))
    share = place - 0.5 - below
    if circular:
        return below % n_bins, (below + 1) % n_bins, share
    return min(max(below, 0), n_bins - 1), min(max(below + 1, 0), n_bins - 1), share


@njit(cache=True, nogil=True)
def _count(points: NDArray[np.float64], cosine: NDArray[np.float64], radius: float, out: NDArray[np.float64]) -> None:
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        flat = np.sqrt(x * x + y * y)
        azimuth = (np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * N_AZIMUTH
        elevation = (np.arctan2(z, flat) / np.pi + 0.5) * N_ELEVATION
        a = _split(azimuth, N_AZIMUTH, True)
        e = _split(elevation, N_ELEVATION, False)
        r = _split(np.sqrt(flat * flat + z * z) / radius * N_RADIAL, N_RADIAL, False)
        c = _split((cosine[i] + 1.0) * 0.5 * N_COSINE, N_COSINE, False)
        for corner in range(16):
            weight = a[2] if corner & 1 else 1.0 - a[2]
            weight *= e[2] if corner & 2 else 1.0 - e[2]
            weight *= r[2] if corner & 4 else 1.0 - r[2]
            weight *= c[2] if corner & 8 else 1.0 - c[2]
            at = a[1] if corner & 1 else a[0]
            at = at * N_ELEVATION + (e[1] if corner & 2 else e[0])
            at = at * N_RADIAL + (r[1] if corner & 4 else r[0])
            out[at * N_COSINE + (c[1] if corner & 8 else c[0])] += weight
