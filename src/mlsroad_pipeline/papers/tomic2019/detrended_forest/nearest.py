"""Nearest supervoxel centroid of each point."""

from __future__ import annotations

from math import ceil

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.geometry.cells import bounding_box, build_cell_grids
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_in_chunks

_SPACING_SAMPLE = 1000
_MAX_ROWS = 2**20


@njit(cache=True, nogil=True)
def _first_of_rows(keys: NDArray, nx: int, n_rows: int) -> NDArray[np.int64]:
    """Return the start of each row of cells in ascending keys; the last entry is the number of keys."""
    first = np.empty(n_rows + 1, np.int64)
    at = 0
    for row in range(n_rows + 1):
        while at < len(keys) and keys[at] < row * nx:
            at += 1
        first[row] = at
    return first


@njit(cache=True, nogil=True)
def _candidates(
    centre: NDArray,
    limit: float,
    key: int,
    reach: int,
    centroids: NDArray,
    order: NDArray,
    keys: NDArray,
    starts: NDArray,
    rows: NDArray,
    shape: tuple[int, int, int],
    candidates: NDArray,
    places: NDArray,
) -> int:
    """List the centroids within `limit` of the centre of a cell, with coordinates; return their number."""
    n = 0
    nx, ny, nz = shape
    ix, iy, iz = key % nx, key // nx % ny, key // (nx * ny)
    # Far from all centroids the window has more rows than there are cells: then all centroids are tested.
    every = (2 * reach + 1) ** 2 > len(keys)
    low, high = max(ix - reach, 0), min(ix + reach, nx - 1)
    for z in range(0 if every else max(iz - reach, 0), 1 if every else min(iz + reach + 1, nz)):
        for y in range(0 if every else max(iy - reach, 0), 1 if every else min(iy + reach + 1, ny)):
            row = z * ny + y
            first, last = np.int64(0), np.int64(len(keys))
            if len(rows) and not every:
                first, last = rows[row], rows[row + 1]
            elif not every:
                first = np.int64(np.searchsorted(keys, row * nx + low))
                last = np.int64(np.searchsorted(keys, row * nx + high, side="right"))
            for cell in range(first, last):
                if not every and not row * nx + low <= keys[cell] <= row * nx + high:
                    continue
                for i in range(starts[cell], starts[cell + 1]):
                    c = order[i]
                    dx, dy, dz = centroids[c, 0] - centre[0], centroids[c, 1] - centre[1], centroids[c, 2] - centre[2]
                    if dx * dx + dy * dy + dz * dz <= limit * limit:
                        candidates[n] = c
                        places[n, 0], places[n, 1], places[n, 2] = centroids[c, 0], centroids[c, 1], centroids[c, 2]
                        n += 1
    return n


@njit(cache=True, nogil=True)
def _search_cells(
    xyz: NDArray,
    p_order: NDArray,
    p_keys: NDArray,
    p_starts: NDArray,
    centres: NDArray,
    nearest: NDArray,
    centroids: NDArray,
    order: NDArray,
    keys: NDArray,
    starts: NDArray,
    rows: NDArray,
    shape: tuple[int, int, int],
    size: float,
    first: int,
    last: int,
    out: NDArray,
) -> None:
    """Write the nearest centroid of every point in cells `first` to `last`."""
    candidates = np.empty(len(order), np.int32)
    places = np.empty((len(order), 3))
    for cell in range(first, last):
        # A point lies within half a diagonal of the centre, hence its nearest centroid within `limit` of the centre.
        limit = nearest[cell] + size * 1.7320509
        reach = np.int64(limit / size) + 2
        n = _candidates(
            centres[cell], limit, p_keys[cell], reach, centroids, order, keys, starts, rows, shape, candidates, places
        )
        for i in range(p_starts[cell], p_starts[cell + 1]):
            p = p_order[i]
            x, y, z = np.float64(xyz[p, 0]), np.float64(xyz[p, 1]), np.float64(xyz[p, 2])
            best, winner = np.inf, -1
            for j in range(n):
                dx, dy, dz = places[j, 0] - x, places[j, 1] - y, places[j, 2] - z
                distance = dx * dx + dy * dy + dz * dz
                if distance < best or (distance == best and candidates[j] < winner):
                    best, winner = distance, candidates[j]
            out[p] = winner


def nearest_supervoxels(xyz: ArrayLike, centroids: ArrayLike, *, n_threads: int = 1) -> NDArray[np.int32]:
    """Return the supervoxel with the nearest centroid for each point (exact search).

    Points are sorted into cells. The centroids that can be nearest to a point of a cell are collected once per cell.
    """
    check_threads(n_threads)
    seeds = check_xyz(centroids, minimum=1, name="centroids").astype(np.float64)
    points = check_xyz(xyz)
    out = np.empty(len(points), np.int32)
    if len(points) == 0:
        return out
    tree = cKDTree(seeds)
    sample = seeds[:: ceil(len(seeds) / _SPACING_SAMPLE)]
    spacing = np.median(tree.query(sample, k=2)[0][:, 1]) if len(seeds) > 1 else 0.0
    boxes = np.vstack([bounding_box(points), bounding_box(seeds)])
    extent = float(np.ptp(boxes, axis=0).max())
    size = float(spacing) / 2 if spacing > 0 else max(extent, 1.0)
    # Distant outliers must not make the grid exceed 64-bit keys.
    size = max(size, extent / 2**20)
    grid, seed_grid = build_cell_grids(points, seeds, cell_size=size)
    nx, ny, nz = grid.shape
    # A table gives the start of each row of cells, unless outliers make it much longer than the points.
    n_rows = ny * nz if ny * nz <= _MAX_ROWS else 0
    rows = _first_of_rows(seed_grid.keys, nx, n_rows) if n_rows else np.empty(0, np.int64)
    centres = grid.centres()
    nearest = tree.query(centres, workers=n_threads)[0]

    def search(first: int, last: int) -> None:
        _search_cells(
            points, grid.order, grid.keys, grid.starts, centres, nearest, seeds, seed_grid.order, seed_grid.keys,
            seed_grid.starts, rows, grid.shape, size, first, last, out,
        )  # fmt: skip

    run_in_chunks(search, len(grid.keys), n_threads=n_threads)
    return out
