"""From supervoxels to points: which supervoxel a point takes its label from."""

from __future__ import annotations

from math import ceil
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.cell_grid import bounding_box, build_cell_grids, check_threads, run_in_chunks
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.detrending import local_tendency
from mlsroad_pipeline.algorithms.validation import check_column, check_xyz

_SPACING_SAMPLE = 1000


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
    shape: tuple[int, int, int],
    found: NDArray,
) -> int:
    """List the centroids within `limit` of a cell's centre, and return how many there are."""
    n = 0
    nx, ny, nz = shape
    ix, iy, iz = key % nx, key // nx % ny, key // (nx * ny)
    # Far from all centroids there are more rows of cells to look at than cells: then all centroids are tested.
    every = (2 * reach + 1) ** 2 > len(keys)
    for z in range(0 if every else max(iz - reach, 0), 1 if every else min(iz + reach + 1, nz)):
        for y in range(0 if every else max(iy - reach, 0), 1 if every else min(iy + reach + 1, ny)):
            first, last = 0, len(order)
            if not every:
                row = (z * ny + y) * nx
                first = starts[np.searchsorted(keys, row + max(ix - reach, 0))]
                last = starts[np.searchsorted(keys, row + min(ix + reach, nx - 1), side="right")]
            for i in range(first, last):
                c = order[i]
                dx, dy, dz = centroids[c, 0] - centre[0], centroids[c, 1] - centre[1], centroids[c, 2] - centre[2]
                if dx * dx + dy * dy + dz * dz <= limit * limit:
                    found[n] = c
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
    shape: tuple[int, int, int],
    size: float,
    first: int,
    last: int,
    out: NDArray,
) -> None:
    """Find the nearest centroid of every point in cells first to last."""
    found = np.empty(len(order), np.int32)
    for cell in range(first, last):
        # A point is at most half a diagonal from the centre, so its nearest centroid is within `limit` of the centre.
        limit = nearest[cell] + size * 1.7320509
        reach = np.int64(limit / size) + 2
        n = _candidates(centres[cell], limit, p_keys[cell], reach, centroids, order, keys, starts, shape, found)
        for i in range(p_starts[cell], p_starts[cell + 1]):
            p = p_order[i]
            best, winner = np.inf, -1
            for j in range(n):
                c = found[j]
                dx, dy, dz = centroids[c, 0] - xyz[p, 0], centroids[c, 1] - xyz[p, 1], centroids[c, 2] - xyz[p, 2]
                distance = dx * dx + dy * dy + dz * dz
                if distance < best or (distance == best and c < winner):
                    best, winner = distance, c
            out[p] = winner


def nearest_supervoxels(xyz: ArrayLike, centroids: ArrayLike, *, n_threads: int = 1) -> NDArray[np.int32]:
    """Find the supervoxel whose centroid is nearest to each point, exactly.

    Points are sorted into cells; the few centroids that can be nearest to any point of a cell are found once for it.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    centroids : array-like of shape (s, 3)
        Centroids of the supervoxels in the same frame.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of int32, shape (n,)
        Supervoxel of each point, of equally near ones the lowest.

    Raises
    ------
    DataError
        If coordinates are not (n, 3) and finite, or there is no centroid.
    ParameterError
        If `n_threads` is below 1.
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
    # Far outliers must not make the grid finer than 64-bit keys can number.
    size = max(size, extent / 2**20)
    grid, seed_grid = build_cell_grids(points, seeds, cell_size=size)
    centres = grid.centres()
    nearest = tree.query(centres, workers=n_threads)[0]

    def search(first: int, last: int) -> None:
        _search_cells(
            points, grid.order, grid.keys, grid.starts, centres, nearest, seeds, seed_grid.order, seed_grid.keys,
            seed_grid.starts, grid.shape, size, first, last, out,
        )  # fmt: skip

    run_in_chunks(search, len(grid.keys), n_threads=n_threads)
    return out


def smooth_probabilities(
    probabilities: NDArray[np.float32], adjacency: csr_array, *, weight: float
) -> NDArray[np.float32]:
    """Let the first-order neighbours of a supervoxel have a say in its class.

    The local context regularises the labels (Tomic et al. 2019, section 4, speak of it without a formula):
    P' = (1 - weight) P + weight mean(P of the neighbours).

    Parameters
    ----------
    probabilities : ndarray of float32, shape (s, c)
        Class probabilities of the supervoxels.
    adjacency : csr_array of shape (s, s)
        First-order neighbours.
    weight : float
        Weight of the neighbours, 0 to 1. More wipes out single mistaken supervoxels, and single supervoxels that are
        right.

    Returns
    -------
    ndarray of float32, shape (s, c)
        Probabilities; a supervoxel without neighbours keeps its own.

    Raises
    ------
    DataError
        If the adjacency has another number of supervoxels.
    ParameterError
        If `weight` is outside 0 to 1.
    """
    if not 0 <= weight <= 1:
        raise ParameterError(f"weight must be in [0, 1], got {weight!r}")
    n = len(probabilities)
    if adjacency.shape != (n, n):
        raise DataError(f"adjacency must have shape ({n}, {n}), got {adjacency.shape}")
    share = np.float32(weight)
    mixed = (1 - share) * probabilities + share * local_tendency(probabilities, adjacency)
    alone = np.diff(adjacency.indptr) == 0
    return np.where(alone[:, None], probabilities, mixed)


def label_points(
    xyz: ArrayLike,
    centroids: ArrayLike,
    probabilities: ArrayLike,
    *,
    rule: Literal["nearest", "own"] = "nearest",
    supervoxel_labels: ArrayLike | None = None,
    n_threads: int = 1,
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give every point the most probable class of its supervoxel (Tomic et al. 2019, section 2 and 3.3).

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    centroids : array-like of shape (s, 3)
        Centroids of the supervoxels, metres, in the same frame; not used by the rule "own".
    probabilities : array-like of shape (s, c)
        Class probabilities of the supervoxels.
    rule : {"nearest", "own"}, default "nearest"
        The supervoxel whose centroid is nearest (the paper), or the one that the point belongs to.
    supervoxel_labels : array-like of int, shape (n,), optional
        Supervoxel of each point; needed by the rule "own" only.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Class of each point, of equally probable ones the lowest.
    confidence : ndarray of float32, shape (n,)
        Its probability.

    Raises
    ------
    DataError
        If coordinates are not (n, 3) and finite, probabilities are not (s, c) and finite, the rule "own" has no
        supervoxel labels, or they do not fit the points or the supervoxels.
    ParameterError
        If the rule is unknown or `n_threads` is below 1.
    """
    table = np.asarray(probabilities, dtype=np.float32)
    n_supervoxels = len(np.asarray(centroids))
    if table.ndim != 2 or len(table) != n_supervoxels or not table.shape[1] or not np.isfinite(table).all():
        raise DataError(f"probabilities must be finite, of shape ({n_supervoxels}, c), got {table.shape}")
    if rule == "nearest":
        owners = nearest_supervoxels(xyz, centroids, n_threads=n_threads)
    elif rule == "own":
        if supervoxel_labels is None:
            raise DataError("rule 'own' needs supervoxel_labels")
        owners = check_column(supervoxel_labels, len(check_xyz(xyz)), "supervoxel_labels")
        if len(owners) and not 0 <= int(owners.min()) <= int(owners.max()) < n_supervoxels:
            raise DataError(f"supervoxel_labels must be in 0..{n_supervoxels - 1}, got {owners.min()}..{owners.max()}")
    else:
        raise ParameterError(f"rule must be 'nearest' or 'own', got {rule!r}")
    best = table.argmax(axis=1)
    return best.astype(np.int16)[owners], table.max(axis=1)[owners]
