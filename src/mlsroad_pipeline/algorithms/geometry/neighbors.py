"""Radius and k-nearest-neighbour search with CSR results.

A CSR pair is (`indices`, `indptr`): the neighbours of query i are ``indices[indptr[i]:indptr[i + 1]]``.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.cells import CELLS_PER_RADIUS, build_cell_grids, first_window, move_window
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_in_chunks


@njit(cache=True, nogil=True)
def _search_rows(
    q_xyz: NDArray,
    q_order: NDArray,
    q_keys: NDArray,
    q_starts: NDArray,
    xyz: NDArray,
    order: NDArray,
    keys: NDArray,
    starts: NDArray,
    rows: NDArray,
    reach: int,
    radius: float,
    out: NDArray,
    indptr: NDArray,
    first: int,
    last: int,
) -> None:
    """Count neighbours of query cells into `indptr` (shifted by one) if `out` is empty, else write them."""
    counting = len(out) == 0
    squared = radius * radius
    if first == last:
        return
    begin, end = first_window(keys, q_keys[first], rows, reach)
    for cell in range(first, last):
        move_window(keys, q_keys[cell], rows, reach, begin, end)
        for qi in range(q_starts[cell], q_starts[cell + 1]):
            q = q_order[qi]
            at = 0 if counting else indptr[q]
            for j in range(len(rows)):
                for i in range(starts[begin[j]], starts[end[j]]):
                    p = order[i]
                    dx = xyz[p, 0] - q_xyz[q, 0]
                    dy = xyz[p, 1] - q_xyz[q, 1]
                    dz = xyz[p, 2] - q_xyz[q, 2]
                    if dx * dx + dy * dy + dz * dz <= squared:
                        if not counting:
                            out[at] = p
                        at += 1
            if counting:
                indptr[q + 1] = at
            else:
                out[indptr[q] : at].sort()


def radius_neighbors(
    xyz: ArrayLike, *, radius: float, queries: ArrayLike | None = None, n_threads: int = 1
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return all points within a radius of each query point."""
    check_positive(radius, "radius")
    points = check_xyz(xyz).astype(np.float64, copy=False)
    at_points = points if queries is None else check_xyz(queries, name="queries").astype(np.float64, copy=False)
    indptr = np.zeros(len(at_points) + 1, np.int64)
    if len(points) == 0 or len(at_points) == 0:
        return np.empty(0, np.int32), indptr
    # Cells are wider by a factor of 1 + 1e-9: rounding cannot put a neighbour out of reach.
    size, reach = radius * (1 + 1e-9) / CELLS_PER_RADIUS, CELLS_PER_RADIUS
    if queries is None:
        grid = query_grid = build_cell_grids(points, cell_size=size, margin=reach)[0]
    else:
        grid, query_grid = build_cell_grids(points, at_points, cell_size=size, margin=reach)
    rows = grid.row_offsets(reach)
    indices = np.empty(0, np.int32)

    def search(first: int, last: int) -> None:
        _search_rows(
            at_points, query_grid.order, query_grid.keys, query_grid.starts, points, grid.order, grid.keys, grid.starts,
            rows, reach, radius, indices, indptr, first, last,
        )  # fmt: skip

    run_in_chunks(search, len(query_grid.keys), n_threads=n_threads)
    np.cumsum(indptr, out=indptr)
    indices = np.empty(int(indptr[-1]), np.int32)
    if len(indices):
        run_in_chunks(search, len(query_grid.keys), n_threads=n_threads)
    return indices, indptr


def nearest_neighbors(
    xyz: ArrayLike, *, k: int, queries: ArrayLike | None = None, n_threads: int = 1
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the k nearest points of each query point."""
    check_at_least(k, 1, "k")
    check_threads(n_threads)
    points = check_xyz(xyz).astype(np.float64, copy=False)
    at_points = points if queries is None else check_xyz(queries, name="queries").astype(np.float64, copy=False)
    n_found = min(k, len(points))
    indptr = np.arange(len(at_points) + 1, dtype=np.int64) * n_found
    if n_found == 0 or len(at_points) == 0:
        return np.empty(0, np.int32), indptr
    distances, indices = cKDTree(points).query(at_points, k=np.arange(1, n_found + 1), workers=n_threads)
    by_index = np.argsort(indices, axis=1, kind="stable")
    distances, indices = np.take_along_axis(distances, by_index, 1), np.take_along_axis(indices, by_index, 1)
    by_distance = np.argsort(distances, axis=1, kind="stable")
    return np.take_along_axis(indices, by_distance, 1).astype(np.int32).ravel(), indptr
