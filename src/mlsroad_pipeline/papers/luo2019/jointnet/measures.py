"""Measures of the size, shape and intensity of objects, which scaled images do not contain."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_FLOOR = 0.05
"""Offset of lengths before the logarithm, metres; smaller lengths are hardly distinguished."""

_LAYERS = 4


@njit(cache=True, nogil=True)
def measure_objects(
    xyz: NDArray[np.float64], indptr: NDArray[np.int64], value: NDArray[np.float64], out: NDArray[np.float32]
) -> None:
    """Compute the measures of objects.

    Lengths are logarithms of metres. "Along" is the horizontal direction of largest spread, "across" is perpendicular.
    """
    for k in range(len(out)):
        first, last = indptr[k], indptr[k + 1]
        n = last - first
        x, y = xyz[first:last, 0] - xyz[first, 0], xyz[first:last, 1] - xyz[first, 1]
        z = xyz[first:last, 2] - xyz[first:last, 2].min()
        x, y = x - x.mean(), y - y.mean()
        angle = 0.5 * np.arctan2(2.0 * (x * y).sum(), (x * x).sum() - (y * y).sum())
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        height = max(z.max(), 1e-3)
        row = out[k]
        for j, axis in enumerate((z, along, across)):
            row[j] = np.log(axis.max() - axis.min() + 2.0 * _FLOOR)
            row[3 + j] = np.log(axis.std() + _FLOOR)
            ordered = np.sort(axis)
            # Symmetric ranks, since the sign of the axis is arbitrary.
            row[9 + j] = np.log(ordered[n - 1 - (n - 1) // 20] - ordered[(n - 1) // 20] + _FLOOR)
            if j == 0:
                for i in range(3):
                    row[6 + i] = ordered[(n - 1) * (i + 1) // 4] / height
        _layers(z / height, along, across, row[12:24])
        _quantiles(np.sqrt(x * x + y * y), row[24:29])
        for i in range(24, 29):
            row[i] = np.log(row[i] + _FLOOR)
        _axes(x, y, z - z.mean(), row[29:34])
        bright = value[first:last]
        row[34], row[35] = bright.mean(), bright.std()
        _quantiles(bright, row[36:41])


@njit(cache=True, nogil=True)
def _quantiles(values: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    ordered, n = np.sort(values), len(values) - 1
    for i, share in enumerate((0.1, 0.25, 0.5, 0.75, 0.9)):
        out[i] = ordered[int(n * share)]


@njit(cache=True, nogil=True)
def _layers(
    height: NDArray[np.float64], along: NDArray[np.float64], across: NDArray[np.float64], out: NDArray[np.float32]
) -> None:
    sums = np.zeros((_LAYERS, 5))
    for i in range(len(height)):
        s = sums[min(int(height[i] * _LAYERS), _LAYERS - 1)]
        s[0] += 1.0
        s[1] += along[i]
        s[2] += along[i] * along[i]
        s[3] += across[i]
        s[4] += across[i] * across[i]
    for layer in range(_LAYERS):
        s = sums[layer]
        c = max(s[0], 1.0)
        out[3 * layer] = s[0] / len(height)
        for j in range(2):
            variance = s[2 + 2 * j] / c - (s[1 + 2 * j] / c) ** 2
            out[3 * layer + 1 + j] = np.log(np.sqrt(max(variance, 0.0)) + _FLOOR)


@njit(cache=True, nogil=True)
def _axes(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    """Compute linearity, planarity and scattering from standard deviations, and the steepness of the extreme axes."""
    covariance = np.zeros((3, 3))
    parts = (x, y, z)
    for i in range(3):
        for j in range(3):
            covariance[i, j] = (parts[i] * parts[j]).mean()
        covariance[i, i] += 1e-8
    values, vectors = np.linalg.eigh(covariance)
    s = np.sqrt(np.maximum(values, 1e-9))
    out[0], out[1], out[2] = (s[2] - s[1]) / s[2], (s[1] - s[0]) / s[2], s[0] / s[2]
    out[3], out[4] = abs(vectors[2, 0]), abs(vectors[2, 2])
