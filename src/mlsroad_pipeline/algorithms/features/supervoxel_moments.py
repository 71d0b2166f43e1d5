"""Moments of coordinates per supervoxel, and features of height, intensity and colour from statistics of columns."""

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
    # minimum, maximum: minimum and maximum, in the unit of the column
    minimum: NDArray[np.float64]
    maximum: NDArray[np.float64]


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


GROUND_HEIGHT_FEATURES = (
    "height_above_ground_mean",
    "height_above_ground_min",
    "height_above_ground_max",
    "height_above_ground_std",
)
"""Columns of `describe_ground_height`."""

OWN_HEIGHT_FEATURES = ("height_range", "height_std")
"""Columns of `describe_own_height`."""


def describe_own_height(moments: SupervoxelMoments) -> NDArray[np.float32]:
    """Return the vertical extent and spread of supervoxels."""
    spread = np.sqrt(np.maximum(moments.covariances[5], 0.0))
    return np.stack([moments.z_range[:, 1] - moments.z_range[:, 0], spread], axis=1).astype(np.float32)


def describe_ground_height(
    height_above_ground: NDArray[np.floating], labels: NDArray[np.int32], n_supervoxels: int
) -> NDArray[np.float32]:
    """Return statistics of the height above ground of each supervoxel."""
    heights = summarise_column(height_above_ground, labels, n_supervoxels)
    return np.stack([heights.mean, heights.minimum, heights.maximum, heights.std], axis=1).astype(np.float32)


COLOUR_FEATURES = (
    "luma_mean",
    "blue_difference_mean",
    "red_difference_mean",
    "luma_std",
    "blue_difference_std",
    "red_difference_std",
)
"""Columns of `describe_colour`."""

INTENSITY_FEATURES = ("intensity_mean", "intensity_std")
"""Columns of `describe_intensity`."""

# RGB in [0, 255] to Y'CbCr in [0, 1] and [-0.5, 0.5] (ITU-R BT.601, full range).
_TO_YCBCR = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]]) / 255.0


@njit(cache=True, nogil=True)
def _colour_sums(rgb: NDArray, labels: NDArray, n_supervoxels: int) -> NDArray[np.int64]:
    sums = np.zeros((n_supervoxels, 10), np.int64)
    for i in range(len(rgb)):
        row = sums[labels[i]]
        r, g, b = np.int64(rgb[i, 0]), np.int64(rgb[i, 1]), np.int64(rgb[i, 2])
        row[0] += 1
        row[1] += r
        row[2] += g
        row[3] += b
        row[4] += r * r
        row[5] += r * g
        row[6] += r * b
        row[7] += g * g
        row[8] += g * b
        row[9] += b * b
    return sums


def describe_colour(rgb: NDArray[np.uint8], labels: NDArray[np.int32], n_supervoxels: int) -> NDArray[np.float32]:
    """Return the mean and standard deviation of the colour of each supervoxel in Y'CbCr.

    Y'CbCr separates brightness, which shadows change, from two colour differences, which they hardly affect. It is a
    linear transform of RGB: the moments are summed exactly, as integers, and converted once per supervoxel.
    """
    sums = _colour_sums(rgb, labels, n_supervoxels)
    counts = np.where(sums[:, 0] > 0, sums[:, 0], np.nan)
    mean = sums[:, 1:4] / counts[:, None]
    second = sums[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) / counts[:, None, None]
    covariance = second - mean[:, :, None] * mean[:, None, :]
    variance = np.einsum("ci,sij,cj->sc", _TO_YCBCR, covariance, _TO_YCBCR)
    return np.hstack([mean @ _TO_YCBCR.T, np.sqrt(np.maximum(variance, 0.0))]).astype(np.float32)


def describe_intensity(
    intensity: NDArray[np.floating], labels: NDArray[np.int32], n_supervoxels: int
) -> NDArray[np.float32]:
    """Return the mean and standard deviation of the intensity of each supervoxel."""
    statistics = summarise_column(intensity, labels, n_supervoxels)
    return np.stack([statistics.mean, statistics.std], axis=1).astype(np.float32)
