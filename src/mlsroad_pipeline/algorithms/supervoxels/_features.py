"""Voxel features: position, normal and colour, one row per voxel."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column
from mlsroad_pipeline.algorithms.geometry.voxels import VoxelGrid
from mlsroad_pipeline.algorithms.geometry.voxels.grid import run_chunks
from mlsroad_pipeline.algorithms.supervoxels import _normals

TENSOR_SCALE = float(1 << 24)  # products of unit normals are rounded to this resolution, so that sums are exact


@njit(cache=True, nogil=True)
def _mean_colours(
    rgb: NDArray[np.uint8],
    voxel_of_point: NDArray[np.int32],
    counts: NDArray[np.int32],
    features: NDArray[np.float64],
) -> None:
    """Write the mean colour of each voxel, in [0, 1], into columns 6 to 8 of the features."""
    sums = np.zeros((len(features), 3), np.int64)
    for i in range(len(voxel_of_point)):
        v = voxel_of_point[i]
        sums[v, 0] += np.int64(rgb[i, 0])
        sums[v, 1] += np.int64(rgb[i, 1])
        sums[v, 2] += np.int64(rgb[i, 2])
    for v in range(len(features)):
        scale = 1.0 / (255.0 * counts[v])
        for j in range(3):
            features[v, 6 + j] = sums[v, j] * scale


def voxel_features(
    grid: VoxelGrid,
    neighbors: tuple[NDArray[np.int64], NDArray[np.int32]],
    rgb: ArrayLike | None,
    normals: ArrayLike | None,
    n_threads: int,
) -> NDArray[np.float64]:
    """Return position in voxel sizes, normal (0 if undefined) and colour (if given) of each voxel, (v, 6) or (v, 9).

    By default, normals are computed from the voxels. `DataError` if `rgb` or `normals` have another length, or `rgb` is
    not uint8.
    """
    n_points = len(grid.voxel_of_point)
    features = np.empty((len(grid), 6 if rgb is None else 9), np.float64)
    features[:, :3] = grid.local_centroids
    if rgb is not None:
        colours = check_column(rgb, n_points, "rgb", width=3)
        if colours.dtype != np.uint8:
            raise DataError(f"rgb must be uint8, got {colours.dtype}")
        _mean_colours(np.ascontiguousarray(colours), grid.voxel_of_point, grid.counts, features)
    if normals is None:
        compute_normals(features, neighbors, np.empty(0, np.int32), n_threads)
    else:
        features[:, 3:6] = _mean_normals(check_column(normals, n_points, "normals", width=3), grid)
    return features


def compute_normals(
    features: NDArray[np.float64],
    neighbors: tuple[NDArray[np.int64], NDArray[np.int32]],
    owner: NDArray[np.int32],
    n_threads: int,
) -> None:
    """Write normals, fitted to the voxels up to two steps away, into columns 3 to 5 of the features.

    `owner` (v,) limits the support to the supervoxel of a voxel; empty for no limit.
    """
    n, within = len(features), len(owner) > 0
    centroids = np.ascontiguousarray(features[:, :3])
    moments = np.empty((n, _normals.N_MOMENTS), np.float64)
    run_chunks(lambda a, b: _normals.first_moments(centroids, *neighbors, owner, within, a, b, moments), n, n_threads)
    run_chunks(
        lambda a, b: _normals.voxel_normals(centroids, *neighbors, owner, within, moments, a, b, features),
        n,
        n_threads,
    )


def _mean_normals(normals: NDArray, grid: VoxelGrid) -> NDArray[np.float64]:
    """Return the main direction of the normals of each voxel, regardless of sign; 0 without normals."""
    unit = np.asarray(normals, dtype=np.float64)
    length = np.linalg.norm(unit, axis=1)
    defined = np.isfinite(length) & (length > 0)
    unit = unit[defined] / length[defined, None]
    voxels, n = grid.voxel_of_point[defined], len(grid)
    tensor = np.zeros((n, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            products = np.rint(unit[:, i] * unit[:, j] * TENSOR_SCALE)
            tensor[:, i, j] = tensor[:, j, i] = np.bincount(voxels, weights=products, minlength=n)
    main: NDArray[np.float64] = np.linalg.eigh(tensor)[1][:, :, 2]
    main[np.bincount(voxels, minlength=n) == 0] = 0.0
    return main
