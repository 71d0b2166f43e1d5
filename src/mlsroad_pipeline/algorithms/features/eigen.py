"""Eigenvalue features of point neighbourhoods (Weinmann et al. 2015; Tomic et al. 2019, section 2.1)."""

from math import log, nan

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.eigen_solver import FAST, solve_symmetric
from mlsroad_pipeline.algorithms.geometry.cells import (
    CELLS_PER_RADIUS,
    build_cell_grids,
    first_window,
    most_near,
    move_window,
)
from mlsroad_pipeline.algorithms.geometry.neighbors import nearest_neighbors
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks

SHAPE_FEATURES = (
    "linearity",
    "planarity",
    "scattering",
    "omnivariance",
    "anisotropy",
    "eigenentropy",
    "change_of_curvature",
)
"""The seven features of Weinmann et al. 2015 used by Tomic et al. 2019, in their order."""

EIGEN_FEATURES = (
    "eigenvalue_1",
    "eigenvalue_2",
    "eigenvalue_3",
    *SHAPE_FEATURES,
    "verticality",
    "nx",
    "ny",
    "nz",
    "direction_x",
    "direction_y",
    "direction_z",
    "neighbor_count",
)
"""Columns of `compute_eigen_features`."""

MINIMUM_NEIGHBORS = 3
LINE_TOLERANCE = 1e-6
"""Ratio of the second to the first eigenvalue below which points are collinear and the normal is undefined."""

_BATCH = 1024


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def emit_features(
    values: NDArray,
    smallest: NDArray,
    largest: NDArray,
    counts: NDArray,
    rows: NDArray,
    first: int,
    last: int,
    out: NDArray,
) -> None:
    """Write rows of `EIGEN_FEATURES` from the eigenproblems `first` to `last` of `solve_symmetric`.

    `counts` are the numbers of points of the neighbourhoods; `rows` are the rows of `out`, float32 (m, 18), of the
    results.
    """
    for i in range(first, last):
        row = out[rows[i]]
        row[17] = counts[i]
        l1, l2, l3 = values[0, i], values[1, i], values[2, i]
        total = l1 + l2 + l3
        known = counts[i] >= MINIMUM_NEIGHBORS
        row[0], row[1], row[2] = (l1, l2, l3) if known else (nan, nan, nan)
        if not known or not total > 0.0:
            row[3:17] = nan
            continue
        e1, e2, e3 = l1 / total, l2 / total, l3 / total
        row[3] = (l1 - l2) / l1
        row[4] = (l2 - l3) / l1
        row[5] = l3 / l1
        row[6] = (e1 * e2 * e3) ** (1.0 / 3.0)
        row[7] = (l1 - l3) / l1
        entropy = -e1 * log(e1)
        entropy -= e2 * log(e2) if e2 > 0.0 else 0.0
        entropy -= e3 * log(e3) if e3 > 0.0 else 0.0
        row[8] = entropy
        row[9] = e3
        if l2 > LINE_TOLERANCE * l1:
            row[10] = 1.0 - smallest[2, i]
            row[11], row[12], row[13] = smallest[0, i], smallest[1, i], smallest[2, i]
        else:
            row[10:14] = nan
        row[14], row[15], row[16] = largest[0, i], largest[1, i], largest[2, i]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def sum_ball(
    near_x: NDArray,
    near_y: NDArray,
    near_z: NDArray,
    n_near: int,
    x: float,
    y: float,
    z: float,
    squared: float,
    covariances: NDArray,
    counts: NDArray,
    at: int,
) -> None:
    """Store the covariance and count of the buffered points within the radius of a query."""
    zero = np.float32(0.0)
    n = sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = zero
    for j in range(n_near):
        dx, dy, dz = near_x[j] - x, near_y[j] - y, near_z[j] - z
        w = np.float32(1.0) if dx * dx + dy * dy + dz * dz <= squared else zero
        wx, wy, wz = w * dx, w * dy, w * dz
        n += w
        sx += wx
        sy += wy
        sz += wz
        sxx += wx * dx
        sxy += wx * dy
        sxz += wx * dz
        syy += wy * dy
        syz += wy * dz
        szz += wz * dz
    inverse = 1.0 / np.float64(n)
    mx, my, mz = sx * inverse, sy * inverse, sz * inverse
    covariances[0, at] = sxx * inverse - mx * mx
    covariances[1, at] = sxy * inverse - mx * my
    covariances[2, at] = sxz * inverse - mx * mz
    covariances[3, at] = syy * inverse - my * my
    covariances[4, at] = syz * inverse - my * mz
    covariances[5, at] = szz * inverse - mz * mz
    counts[at] = n


@njit(cache=True, nogil=True, fastmath=FAST)
def gather_near(
    local: NDArray,
    starts: NDArray,
    begin: NDArray,
    end: NDArray,
    rows: NDArray,
    keys: NDArray,
    key: int,
    size: float,
    squared: float,
    near_x: NDArray,
    near_y: NDArray,
    near_z: NDArray,
) -> int:
    """Copy the points within reach of the points of a cell, relative to the centre of the cell; return their number."""
    n_near = 0
    half = np.float32(0.5 * size)
    zero = np.float32(0.0)
    for j in range(len(rows)):
        shift_y, shift_z = np.float32(rows[j, 0] * size), np.float32(rows[j, 1] * size)
        for cell in range(begin[j], end[j]):
            shift_x = np.float32((keys[cell] - key - rows[j, 2]) * size)
            for i in range(starts[cell], starts[cell + 1]):
                x, y, z = local[0, i] + shift_x, local[1, i] + shift_y, local[2, i] + shift_z
                near_x[n_near], near_y[n_near], near_z[n_near] = x, y, z
                gx, gy, gz = max(abs(x) - half, zero), max(abs(y) - half, zero), max(abs(z) - half, zero)
                n_near += gx * gx + gy * gy + gz * gz <= squared
    return n_near


@njit(cache=True, nogil=True, error_model="numpy")
def _radius_features(
    order: NDArray,
    keys: NDArray,
    starts: NDArray,
    local: NDArray,
    size: float,
    rows: NDArray,
    reach: int,
    radius: float,
    first: int,
    last: int,
    out: NDArray,
) -> None:
    """Compute the features of the points in cells `first` to `last`, in batches."""
    squared = np.float32(radius * radius)
    begin, end = first_window(keys, keys[first], rows, reach)
    near_x = np.empty(1, np.float32)
    near_y, near_z = near_x, near_x
    covariances = np.empty((6, _BATCH), np.float64)
    values, smallest, largest = np.empty((3, _BATCH)), np.empty((3, _BATCH)), np.empty((3, _BATCH))
    counts = np.empty(_BATCH, np.float32)
    n_batch = 0
    stop = starts[last]
    for cell in range(first, last):
        move_window(keys, keys[cell], rows, reach, begin, end)
        bound = most_near(starts, begin, end)
        if bound > len(near_x):
            near_x = np.empty(2 * bound, np.float32)
            near_y, near_z = np.empty_like(near_x), np.empty_like(near_x)
        n_near = gather_near(local, starts, begin, end, rows, keys, keys[cell], size, squared, near_x, near_y, near_z)
        for i in range(starts[cell], starts[cell + 1]):
            x, y, z = local[0, i], local[1, i], local[2, i]
            sum_ball(near_x, near_y, near_z, n_near, x, y, z, squared, covariances, counts, n_batch)
            n_batch += 1
            if n_batch == _BATCH or i == stop - 1:
                solve_symmetric(covariances, n_batch, values, smallest, largest)
                emit_features(values, smallest, largest, counts, order[i + 1 - n_batch : i + 1], 0, n_batch, out)
                n_batch = 0


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _listed_features(xyz: NDArray, indices: NDArray, indptr: NDArray, first: int, last: int, out: NDArray) -> None:
    """Compute the features of given neighbourhoods in float64."""
    n_rows = last - first
    covariances, counts = np.empty((6, n_rows)), np.empty(n_rows, np.float32)
    for q in range(first, last):
        s = np.zeros(9)
        for a in range(indptr[q], indptr[q + 1]):
            p = indices[a]
            dx, dy, dz = xyz[p, 0] - xyz[q, 0], xyz[p, 1] - xyz[q, 1], xyz[p, 2] - xyz[q, 2]
            s[0] += dx
            s[1] += dy
            s[2] += dz
            s[3] += dx * dx
            s[4] += dx * dy
            s[5] += dx * dz
            s[6] += dy * dy
            s[7] += dy * dz
            s[8] += dz * dz
        s /= indptr[q + 1] - indptr[q]
        at = q - first
        covariances[0, at], covariances[1, at], covariances[2, at] = (
            s[3] - s[0] ** 2,
            s[4] - s[0] * s[1],
            s[5] - s[0] * s[2],
        )
        covariances[3, at], covariances[4, at], covariances[5, at] = (
            s[6] - s[1] ** 2,
            s[7] - s[1] * s[2],
            s[8] - s[2] ** 2,
        )
        counts[at] = indptr[q + 1] - indptr[q]
    values, smallest, largest = np.empty((3, n_rows)), np.empty((3, n_rows)), np.empty((3, n_rows))
    solve_symmetric(covariances, n_rows, values, smallest, largest)
    emit_features(values, smallest, largest, counts, np.arange(first, last), 0, n_rows, out)


def compute_eigen_features(
    xyz: ArrayLike, *, radius: float | None = None, k: int | None = None, n_threads: int = 1
) -> dict[str, NDArray[np.float32]]:
    """Compute eigenvalue features of the neighbourhood of each point.

    With eigenvalues l1 >= l2 >= l3 and e_i = l_i / (l1 + l2 + l3) (Weinmann et al. 2015): linearity (l1 - l2) / l1,
    planarity (l2 - l3) / l1, scattering l3 / l1, omnivariance (e1 e2 e3)^(1/3), anisotropy (l1 - l3) / l1,
    eigenentropy -sum e_i ln e_i, change of curvature e3. The normal is the eigenvector of l3 with nz >= 0, the
    direction that of l1 with z >= 0, and verticality is 1 - nz.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    radius : float, optional
        Radius of the neighbourhood in metres; the point itself is included. Larger values reduce noise and blur small
        objects; the time grows quadratically. Pairs whose distance equals the radius to seven digits may be in or out.
    k : int, optional
        Number of nearest points of the neighbourhood, including the point itself. Give exactly one of `radius` and `k`.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    dict of str to ndarray of float32, shape (n,)
        One column per name in `EIGEN_FEATURES`: eigenvalues of the population covariance in square metres, and
        dimensionless features. They agree with float64 to 1e-6 of the largest eigenvalue. With fewer than three points
        all but ``neighbor_count`` are NaN. If all points coincide, the eigenvalues are 0 and the other features NaN.
        For collinear points, normal and verticality are NaN.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) and finite, or its extent is too large for the radius.
    ParameterError
        If not exactly one of `radius` and `k` is given, `radius` is not positive, or `k` or `n_threads` is below 1.
    """
    if (radius is None) == (k is None):
        raise ParameterError(f"give exactly one of radius and k, got radius={radius!r} and k={k!r}")
    points = check_xyz(xyz)
    if radius is not None:
        check_positive(radius, "radius")
    out = np.full((len(points), len(EIGEN_FEATURES)), np.nan, np.float32)
    if len(points) and radius is not None:
        _describe_balls(points, radius, n_threads, out)
    elif k is not None:
        _describe_nearest(points, k, n_threads, out)
    return {name: np.ascontiguousarray(out[:, j]) for j, name in enumerate(EIGEN_FEATURES)}


def _describe_balls(points: NDArray[np.floating], radius: float, n_threads: int, out: NDArray[np.float32]) -> None:
    # Slightly wider cells: a neighbour whose float32 distance rounds down to the radius must be in reach.
    size, reach = radius * (1 + 1e-6) / CELLS_PER_RADIUS, CELLS_PER_RADIUS
    grid = build_cell_grids(points, cell_size=size, margin=reach)[0]
    rows = grid.row_offsets(reach)

    def run(first: int, last: int) -> None:
        _radius_features(grid.order, grid.keys, grid.starts, grid.local, size, rows, reach, radius, first, last, out)

    run_in_chunks(run, len(grid.keys), n_threads=n_threads)


def _describe_nearest(points: NDArray[np.floating], k: int, n_threads: int, out: NDArray[np.float32]) -> None:
    indices, indptr = nearest_neighbors(points, k=k, n_threads=n_threads)
    if len(points) == 0:
        return
    centred = points.astype(np.float64) - points[0]

    def run(first: int, last: int) -> None:
        _listed_features(centred, indices, indptr, first, last, out)

    run_in_chunks(run, len(points), n_threads=n_threads)
