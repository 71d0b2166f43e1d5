"""Voxel features (position, normal and colour, one row per voxel) and the kernels of the normals."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column
from mlsroad_pipeline.algorithms.geometry.threads import run_ranges
from mlsroad_pipeline.algorithms.geometry.voxels import VoxelGrid

N_MOMENTS = 10  # count, x, y, z, xx, xy, xz, yy, yz, zz
LAGUERRE_STEPS = 5
BLOCK = 256  # voxels whose normals are solved side by side
COLLINEAR = 1e-12  # squared sine-like measure below which two eigenvalues vanish together


@njit(cache=True, nogil=True)
def first_moments(
    centroids: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
    within: bool,
    start: int,
    stop: int,
    out: NDArray[np.float64],
) -> None:
    """Sum the moments of each voxel and its neighbours, only `within` its supervoxel or over all."""
    for v in range(start, stop):
        x, y, z = centroids[v, 0], centroids[v, 1], centroids[v, 2]
        n, sx, sy, sz = 1.0, x, y, z
        xx, xy, xz, yy, yz, zz = x * x, x * y, x * z, y * y, y * z, z * z
        for k in range(indptr[v], indptr[v + 1]):
            u = np.uint32(indices[k])
            if within and owner[u] != owner[v]:
                continue
            x, y, z = centroids[u, 0], centroids[u, 1], centroids[u, 2]
            n += 1.0
            sx += x
            sy += y
            sz += z
            xx += x * x
            xy += x * y
            xz += x * z
            yy += y * y
            yz += y * z
            zz += z * z
        out[v, 0], out[v, 1], out[v, 2], out[v, 3] = n, sx, sy, sz
        out[v, 4], out[v, 5], out[v, 6], out[v, 7], out[v, 8], out[v, 9] = xx, xy, xz, yy, yz, zz


@njit(cache=True, nogil=True, error_model="numpy")
def smallest_eigenvectors(matrices: NDArray[np.float64], n: int, vectors: NDArray[np.float64]) -> None:
    """Write the unit eigenvectors of the smallest eigenvalues of n positive semidefinite matrices.

    Rows of `matrices` are xx, xy, xz, yy, yz, zz. The loop has no branches and vectorises.
    """
    for i in range(n):
        trace = matrices[0, i] + matrices[3, i] + matrices[5, i]
        scale = 1.0 / trace if trace > 0.0 else 0.0
        a, b, c = matrices[0, i] * scale, matrices[1, i] * scale, matrices[2, i] * scale
        d, e, f = matrices[3, i] * scale, matrices[4, i] * scale, matrices[5, i] * scale
        c1 = a * d - b * b + a * f - c * c + d * f - e * e
        c0 = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
        root = 0.0
        for _ in range(LAGUERRE_STEPS):
            value = ((root - 1.0) * root + c1) * root - c0
            slope = (3.0 * root - 2.0) * root + c1
            radicand = 4.0 * slope * slope - 6.0 * value * (6.0 * root - 2.0)
            below = slope + np.sqrt(radicand if radicand > 0.0 else 0.0)
            step = -3.0 * value / below
            root += step if (value < 0.0) & (slope > 0.0) else 0.0
        a, d, f = a - root, d - root, f - root
        x, y, z = b * e - c * d, c * b - a * e, a * d - b * b  # rows 1 x 2
        x2, y2, z2 = b * f - c * e, c * c - a * f, a * e - b * c  # rows 1 x 3
        x3, y3, z3 = d * f - e * e, e * c - b * f, b * e - d * c  # rows 2 x 3
        s, s2, s3 = x * x + y * y + z * z, x2 * x2 + y2 * y2 + z2 * z2, x3 * x3 + y3 * y3 + z3 * z3
        x, y, z, s = (x2 if s2 > s else x), (y2 if s2 > s else y), (z2 if s2 > s else z), (s2 if s2 > s else s)
        x, y, z, s = (x3 if s3 > s else x), (y3 if s3 > s else y), (z3 if s3 > s else z), (s3 if s3 > s else s)
        scale = 1.0 / np.sqrt(s) if s > COLLINEAR else 0.0
        vectors[0, i], vectors[1, i], vectors[2, i] = x * scale, y * scale, z * scale


@njit(cache=True, nogil=True, error_model="numpy")
def voxel_normals(
    centroids: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
    within: bool,
    moments: NDArray[np.float64],
    start: int,
    stop: int,
    features: NDArray[np.float64],
) -> None:
    """Write the normal of each voxel into columns 3 to 5 of the features.

    The support is the voxel, its neighbours and their neighbours, each weighted by the number of walks of at most two
    steps to it, so that near voxels have larger weights.
    """
    matrices = np.empty((6, BLOCK), np.float64)
    vectors = np.empty((3, BLOCK), np.float64)
    for v in range(start, stop):
        x, y, z = centroids[v, 0], centroids[v, 1], centroids[v, 2]
        n, sx, sy, sz = 1.0 + moments[v, 0], x + moments[v, 1], y + moments[v, 2], z + moments[v, 3]
        xx, xy, xz = x * x + moments[v, 4], x * y + moments[v, 5], x * z + moments[v, 6]
        yy, yz, zz = y * y + moments[v, 7], y * z + moments[v, 8], z * z + moments[v, 9]
        for k in range(indptr[v], indptr[v + 1]):
            u = np.uint32(indices[k])  # unsigned: no test for negative indices
            if within and owner[u] != owner[v]:
                continue
            n += moments[u, 0]
            sx += moments[u, 1]
            sy += moments[u, 2]
            sz += moments[u, 3]
            xx += moments[u, 4]
            xy += moments[u, 5]
            xz += moments[u, 6]
            yy += moments[u, 7]
            yz += moments[u, 8]
            zz += moments[u, 9]
        w = 1.0 / n
        x, y, z = sx * w, sy * w, sz * w
        i = (v - start) % BLOCK
        matrices[0, i], matrices[1, i], matrices[2, i] = xx * w - x * x, xy * w - x * y, xz * w - x * z
        matrices[3, i], matrices[4, i], matrices[5, i] = yy * w - y * y, yz * w - y * z, zz * w - z * z
        if i == BLOCK - 1 or v == stop - 1:
            smallest_eigenvectors(matrices, i + 1, vectors)
            for j in range(i + 1):
                for axis in range(3):
                    features[v - i + j, 3 + axis] = vectors[axis, j]


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
    moments = np.empty((n, N_MOMENTS), np.float64)
    run_ranges(lambda a, b: first_moments(centroids, *neighbors, owner, within, a, b, moments), n, n_threads)
    run_ranges(
        lambda a, b: voxel_normals(centroids, *neighbors, owner, within, moments, a, b, features),
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
