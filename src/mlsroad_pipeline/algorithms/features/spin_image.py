"""Spin images of oriented points (Johnson 1997)."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.neighbors import radius_neighbors
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks


def compute_spin_images(
    xyz: ArrayLike,
    normals: ArrayLike,
    *,
    radius: float,
    n_radial: int = 9,
    n_axial: int = 17,
    queries: ArrayLike | None = None,
    n_threads: int = 1,
) -> NDArray[np.float32]:
    """Compute the spin images of oriented points.

    A neighbour at offset d from a point with normal n has the axial coordinate beta = n . d in [-r, r] and the radial
    coordinate alpha, its distance from the line along n, in [0, r] (Johnson and Hebert 1999, equation 1).
    """
    check_positive(radius, "radius")
    for name, number in (("n_radial", n_radial), ("n_axial", n_axial)):
        check_at_least(number, 2, name)
    points = check_xyz(xyz).astype(np.float64, copy=False)
    at_points = points if queries is None else check_xyz(queries, name="queries").astype(np.float64, copy=False)
    axes = np.ascontiguousarray(check_column(normals, len(at_points), "normals", width=3), dtype=np.float64)
    out = np.zeros((len(at_points), n_radial * n_axial), np.float32)
    indices, indptr = radius_neighbors(points, radius=radius, queries=at_points, n_threads=n_threads)
    reach = radius / np.sqrt(2.0)

    def count(first: int, last: int) -> None:
        _count(points, at_points, axes, indices, indptr, reach, n_radial, n_axial, out, first, last)

    run_in_chunks(count, len(at_points), n_threads=n_threads)
    return out


@njit(cache=True, nogil=True)
def _count(
    points: NDArray[np.float64],
    queries: NDArray[np.float64],
    axes: NDArray[np.float64],
    indices: NDArray[np.int32],
    indptr: NDArray[np.int64],
    reach: float,
    n_radial: int,
    n_axial: int,
    out: NDArray[np.float32],
    first: int,
    last: int,
) -> None:
    image = np.zeros(n_radial * n_axial)
    for q in range(first, last):
        nx, ny, nz = axes[q, 0], axes[q, 1], axes[q, 2]
        if not np.isfinite(nx + ny + nz):
            continue
        image[:] = 0.0
        total = 0.0
        for i in range(indptr[q], indptr[q + 1]):
            p = indices[i]
            dx, dy, dz = points[p, 0] - queries[q, 0], points[p, 1] - queries[q, 1], points[p, 2] - queries[q, 2]
            squared = dx * dx + dy * dy + dz * dz
            beta = nx * dx + ny * dy + nz * dz
            alpha = np.sqrt(max(squared - beta * beta, 0.0))
            if squared == 0.0 or alpha > reach or abs(beta) > reach:
                continue
            row = alpha / reach * (n_radial - 1)
            column = (beta / reach + 1.0) * 0.5 * (n_axial - 1)
            r, c = min(int(row), n_radial - 2), min(int(column), n_axial - 2)
            u, v = row - r, column - c
            at = r * n_axial + c
            image[at] += (1.0 - u) * (1.0 - v)
            image[at + 1] += (1.0 - u) * v
            image[at + n_axial] += u * (1.0 - v)
            image[at + n_axial + 1] += u * v
            total += 1.0
        if total > 0.0:
            for j in range(len(image)):
                out[q, j] = image[j] / total
