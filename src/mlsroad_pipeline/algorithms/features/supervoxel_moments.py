"""Moments of coordinates and statistics of columns per supervoxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

# Columns of the accumulator: count, reference point, first and second moments about it, lowest and highest z.
_N, _REFERENCE, _FIRST, _SECOND, _LOW, _HIGH, _WIDTH = 0, 1, 4, 7, 13, 14, 16


@dataclass(frozen=True)
class SupervoxelMoments:
    """Moments of the points of each supervoxel."""

    counts: NDArray[np.int64]  # Number of points
    centroids: NDArray[np.float64]  # Mean coordinates, metres; NaN without points
    covariances: NDArray[np.float64]  # Rows xx, xy, xz, yy, yz, zz, square metres, divided by the number of points
    z_range: NDArray[np.float64]  # Lowest and highest z, metres


@njit(cache=True, nogil=True)
def _accumulate(xyz: NDArray, labels: NDArray, n_supervoxels: int) -> NDArray[np.float64]:
    sums = np.zeros((n_supervoxels, _WIDTH))
    for i in range(len(xyz)):
        row = sums[labels[i]]
        x, y, z = np.float64(xyz[i, 0]), np.float64(xyz[i, 1]), np.float64(xyz[i, 2])
        if row[_N] == 0.0:
            # The first point is the reference: large coordinates would reduce the precision of the moments.
            row[1], row[2], row[3] = x, y, z
            row[_LOW], row[_HIGH] = z, z
        row[_N] += 1.0
        dx, dy, dz = x - row[1], y - row[2], z - row[3]
        row[4] += dx
        row[5] += dy
        row[6] += dz
        row[7] += dx * dx
        row[8] += dx * dy
        row[9] += dx * dz
        row[10] += dy * dy
        row[11] += dy * dz
        row[12] += dz * dz
        row[_LOW] = min(row[_LOW], z)
        row[_HIGH] = max(row[_HIGH], z)
    return sums


@njit(cache=True, nogil=True, error_model="numpy")
def _merge(sums: NDArray, indices: NDArray, indptr: NDArray) -> NDArray[np.float64]:
    """Add the moments of the neighbours, relative to the reference point of the supervoxel."""
    merged = sums.copy()
    for s in range(len(sums)):
        row = merged[s]
        for j in range(indptr[s], indptr[s + 1]):
            other = sums[indices[j]]
            n = other[_N]
            tx, ty, tz = other[1] - row[1], other[2] - row[2], other[3] - row[3]
            sx, sy, sz = other[4], other[5], other[6]
            row[_N] += n
            row[4] += sx + n * tx
            row[5] += sy + n * ty
            row[6] += sz + n * tz
            row[7] += other[7] + 2.0 * sx * tx + n * tx * tx
            row[8] += other[8] + sx * ty + sy * tx + n * tx * ty
            row[9] += other[9] + sx * tz + sz * tx + n * tx * tz
            row[10] += other[10] + 2.0 * sy * ty + n * ty * ty
            row[11] += other[11] + sy * tz + sz * ty + n * ty * tz
            row[12] += other[12] + 2.0 * sz * tz + n * tz * tz
            row[_LOW] = min(row[_LOW], other[_LOW])
            row[_HIGH] = max(row[_HIGH], other[_HIGH])
    return merged


def _finish(sums: NDArray[np.float64]) -> SupervoxelMoments:
    counts = sums[:, _N]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums[:, _FIRST:_SECOND] / counts[:, None]
        covariances = (sums[:, _SECOND:_LOW] / counts[:, None]).T.copy()
    x, y, z = mean.T
    covariances -= np.stack([x * x, x * y, x * z, y * y, y * z, z * z])
    return SupervoxelMoments(
        counts=counts.astype(np.int64),
        centroids=sums[:, _REFERENCE:_FIRST] + mean,
        covariances=covariances,
        z_range=sums[:, _LOW : _HIGH + 1].copy(),
    )


def sum_moments(
    xyz: NDArray[np.floating], labels: NDArray[np.int32], n_supervoxels: int, adjacency: csr_array | None = None
) -> tuple[SupervoxelMoments, SupervoxelMoments | None]:
    """Return the moments of each supervoxel and, with an adjacency, of its region with first-order neighbours."""
    sums = _accumulate(xyz, labels, n_supervoxels)
    if adjacency is None:
        return _finish(sums), None
    return _finish(sums), _finish(_merge(sums, adjacency.indices, adjacency.indptr))


@njit(cache=True, nogil=True, error_model="numpy")
def _column_sums(values: NDArray, labels: NDArray, n_supervoxels: int) -> NDArray[np.float64]:
    sums = np.zeros((n_supervoxels, 5))
    for i in range(len(values)):
        value = np.float64(values[i])
        if np.isnan(value):
            continue
        row = sums[labels[i]]
        if row[0] == 0.0:
            row[3], row[4] = value, value
        row[0] += 1.0
        row[1] += value
        row[2] += value * value
        row[3] = min(row[3], value)
        row[4] = max(row[4], value)
    return sums


@dataclass(frozen=True)
class ColumnStatistics:
    """Statistics of a column over the points of each supervoxel; NaN without values."""

    mean: NDArray[np.float64]  # Mean, in the unit of the column
    std: NDArray[np.float64]  # Population standard deviation, in the unit of the column
    minimum: NDArray[np.float64]  # Minimum and maximum, in the unit of the column
    maximum: NDArray[np.float64]  # Minimum and maximum, in the unit of the column


def summarise_column(values: NDArray, labels: NDArray[np.int32], n_supervoxels: int) -> ColumnStatistics:
    """Return statistics of a per-point column for each supervoxel, ignoring NaN."""
    sums = _column_sums(values, labels, n_supervoxels)
    counts = np.where(sums[:, 0] > 0, sums[:, 0], np.nan)
    mean = sums[:, 1] / counts
    variance = np.maximum(sums[:, 2] / counts - mean * mean, 0.0)
    empty = np.isnan(counts)
    return ColumnStatistics(
        mean, np.sqrt(variance), np.where(empty, np.nan, sums[:, 3]), np.where(empty, np.nan, sums[:, 4])
    )
