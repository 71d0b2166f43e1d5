"""Radiometric features of supervoxels: colour and intensity (Tomic et al. 2019, section 2.1)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.supervoxel_moments import summarise_column

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
