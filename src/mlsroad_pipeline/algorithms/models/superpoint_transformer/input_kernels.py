"""Compiled kernels that write the inputs of the network, in float32."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_NEAREST = np.float32(1e-6)
"""Least distance in metres that directions are divided by."""
_QUARTER = np.float32(0.25)


@njit(cache=True, nogil=True, error_model="numpy")
def write_points(
    values: NDArray[np.float32],
    offset: NDArray[np.float32],
    rows: NDArray[np.int64],
    owner: NDArray[np.int64],
    scale: tuple[NDArray[np.float32], NDArray[np.float32]],
    limit: np.float32,
    radius: NDArray[np.float32],
    flags: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Write standardised features, flags of known ones, relative position and radius of some points."""
    n_features, n_flags = values.shape[1], len(flags)
    mean, deviation = scale
    for i in range(len(rows)):
        row, own = out[i], rows[i]
        for k in range(n_features):
            value = (values[own, k] - mean[k]) / deviation[k]
            row[k] = np.float32(0.0) if np.isnan(value) else min(max(value, -limit), limit)
        for k in range(n_flags):
            row[n_features + k] = np.float32(1.0) if np.isfinite(values[own, flags[k]]) else np.float32(0.0)
        for k in range(3):
            row[n_features + n_flags + k] = offset[own, k] / radius[owner[i], 0]
        row[n_features + n_flags + 3] = radius[owner[i], 1]


@njit(cache=True, nogil=True, error_model="numpy")
def write_edges(
    centroid: NDArray[np.float32],
    normal: NDArray[np.float32],
    size: NDArray[np.float32],
    target: NDArray[np.int64],
    source: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Write direction, distance, angles, ratios of sizes and height of edges; distance and height are in metres."""
    for e in range(len(target)):
        t, s, row = target[e], source[e], out[e]
        x, y, z = centroid[s, 0] - centroid[t, 0], centroid[s, 1] - centroid[t, 1], centroid[s, 2] - centroid[t, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        reach = max(distance, _NEAREST)
        row[0], row[1], row[2], row[3] = x / reach, y / reach, z / reach, distance
        between, first, second = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(3):
            between += normal[t, k] * normal[s, k]
            first += normal[t, k] * row[k]
            second += normal[s, k] * row[k]
        row[4], row[5], row[6] = abs(between), abs(first), abs(second)
        for k in range(4):
            row[7 + k] = (size[s, k] - size[t, k]) * _QUARTER
        row[11] = z
