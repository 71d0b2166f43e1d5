"""Voxels of clusters for the normalised cut: positions, intensities and clusters."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def number_voxels(clusters: NDArray[np.int32], voxel_of_point: NDArray[np.int32]) -> NDArray[np.int64]:
    """Number the voxels; a voxel shared by two clusters has one number for each."""
    pairs = voxel_of_point.astype(np.int64) * (int(clusters.max()) + 1) + clusters
    return np.unique(pairs, return_inverse=True)[1].astype(np.int64)


@njit(cache=True, nogil=True)
def measure_voxels(
    points: NDArray, values: NDArray[np.float64], voxel: NDArray[np.int64], clusters: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return centroid and interpolated intensity (equations 4, 8, 9) of each voxel, and its cluster."""
    n = voxel.max() + 1
    places, counts = np.zeros((n, 4)), np.zeros(n)
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    of_voxel = np.empty(n, np.int32)
    for i in range(len(voxel)):
        v = voxel[i]
        for axis in range(3):
            places[v, axis] += points[i, axis]
        counts[v] += 1.0
        low[v], high[v] = min(low[v], values[i]), max(high[v], values[i])
        of_voxel[v] = clusters[i]
    weights = np.zeros(n)
    for i in range(len(voxel)):
        v = voxel[i]
        # Equation 9 is 0/0 for a constant intensity: all points then have the same weight, which gives the mean.
        w = (values[i] - low[v]) / (high[v] - low[v]) if high[v] > low[v] else 1.0
        places[v, 3] += w * values[i]
        weights[v] += w
    for v in range(n):
        for axis in range(3):
            places[v, axis] /= counts[v]
        places[v, 3] /= weights[v]
    return places, of_voxel


def smooth_intensities(places: NDArray[np.float64], clusters: NDArray[np.int32], *, size: float) -> NDArray[np.float64]:
    """Return the mean intensity of each voxel's cell and its 26 neighbours within the cluster."""
    cell = np.floor((places[:, :3] - places[:, :3].min(axis=0)) / size).astype(np.int64) + 1
    nx, ny, nz = (int(most) + 2 for most in cell.max(axis=0))  # an empty border keeps neighbours from wrapping
    names, of_cell = np.unique(
        ((clusters.astype(np.int64) * nx + cell[:, 0]) * ny + cell[:, 1]) * nz + cell[:, 2], return_inverse=True
    )
    own = np.bincount(of_cell, weights=places[:, 3]), np.bincount(of_cell).astype(np.float64)
    total, count = np.zeros(len(names)), np.zeros(len(names))
    for dx, dy, dz in np.ndindex(3, 3, 3):
        beside = names + ((dx - 1) * ny + dy - 1) * nz + dz - 1
        row = np.minimum(np.searchsorted(names, beside), len(names) - 1)
        there = names[row] == beside
        total += np.where(there, own[0][row], 0.0)
        count += np.where(there, own[1][row], 0.0)
    return np.asarray((total / count)[of_cell])
