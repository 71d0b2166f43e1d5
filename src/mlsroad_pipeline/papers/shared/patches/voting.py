"""Point labels by majority vote of the surrounding patches (Luo et al. 2016, equation 8)."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.cells import build_cell_grids
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_in_chunks


@njit(cache=True, nogil=True)
def _near_patches(
    key: int, rows: NDArray, keys: NDArray, starts: NDArray, order: NDArray, near: NDArray
) -> NDArray[np.int32]:
    """List the patches in a cell and in its 26 neighbours."""
    n = 0
    for j in range(len(rows)):
        low = key + rows[j, 2] - 1
        cell = np.searchsorted(keys, low)
        while cell < len(keys) and keys[cell] <= low + 2:
            for i in range(starts[cell], starts[cell + 1]):
                if n == len(near):
                    near = np.concatenate((near, np.empty_like(near)))
                near[n] = order[i]
                n += 1
            cell += 1
    return near[:n]


@njit(cache=True, nogil=True)
def _vote(
    xyz: NDArray,
    order: NDArray,
    keys: NDArray,
    starts: NDArray,
    centroids: NDArray,
    probabilities: NDArray,
    best: NDArray,
    patch_order: NDArray,
    patch_keys: NDArray,
    patch_starts: NDArray,
    rows: NDArray,
    radius: float,
    first: int,
    last: int,
    label: NDArray,
    confidence: NDArray,
) -> None:
    """Label the points in cells `first` to `last`; points without a patch within the radius keep label -1."""
    n_classes = probabilities.shape[1]
    votes, sums = np.zeros(n_classes, np.int64), np.zeros(n_classes)
    buffer = np.empty(64, np.int32)
    voters = np.empty(64, np.int32)
    for cell in range(first, last):
        near = _near_patches(keys[cell], rows, patch_keys, patch_starts, patch_order, buffer)
        if len(near) > len(voters):
            voters = np.empty(2 * len(near), np.int32)
        for i in range(starts[cell], starts[cell + 1]):
            p = order[i]
            n_voters = 0
            for c in near:
                dx, dy, dz = xyz[p, 0] - centroids[c, 0], xyz[p, 1] - centroids[c, 1], xyz[p, 2] - centroids[c, 2]
                voters[n_voters] = c
                n_voters += dx * dx + dy * dy + dz * dz <= radius * radius
            if n_voters == 0:
                continue
            for c in voters[:n_voters]:
                votes[best[c]] += 1
            for c in voters[:n_voters]:
                if sums[best[c]] == 0.0:  # sum the probabilities of each voted class once
                    for other in voters[:n_voters]:
                        sums[best[c]] += probabilities[other, best[c]]
            winner = best[voters[0]]
            for c in voters[:n_voters]:
                a = best[c]
                more = votes[a] > votes[winner]
                even = votes[a] == votes[winner]
                if more or (even and (sums[a] > sums[winner] or (sums[a] == sums[winner] and a < winner))):
                    winner = a
            label[p] = winner
            confidence[p] = sums[winner] / n_voters
            for c in voters[:n_voters]:
                votes[best[c]] = 0
                sums[best[c]] = 0.0


def vote_on_points(
    xyz: ArrayLike, centroids: ArrayLike, probabilities: ArrayLike, *, radius: float, n_threads: int = 1
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Label points by the majority vote of the patches within a radius (Luo et al. 2016, equation 8)."""
    check_positive(radius, "radius")
    check_threads(n_threads)
    points = check_xyz(xyz).astype(np.float64, copy=False)
    seeds = check_xyz(centroids, minimum=1, name="centroids").astype(np.float64, copy=False)
    table = np.ascontiguousarray(probabilities, dtype=np.float64)
    if table.ndim != 2 or len(table) != len(seeds) or not table.shape[1] or not np.isfinite(table).all():
        raise DataError(f"probabilities must be finite, of shape ({len(seeds)}, c), got {table.shape}")
    best = table.argmax(axis=1).astype(np.int64)
    label, confidence = np.full(len(points), -1, np.int16), np.zeros(len(points), np.float32)
    if len(points) == 0:
        return label, confidence
    # Cells are wider than the radius by a factor of 1 + 1e-9: rounding cannot put a neighbour two cells away.
    grid, patch_grid = build_cell_grids(points, seeds, cell_size=radius * (1 + 1e-9))
    rows = grid.row_offsets(1)

    def run(first: int, last: int) -> None:
        _vote(
            points, grid.order, grid.keys, grid.starts, seeds, table, best, patch_grid.order, patch_grid.keys,
            patch_grid.starts, rows, radius, first, last, label, confidence,
        )  # fmt: skip

    run_in_chunks(run, len(grid.keys), n_threads=n_threads)
    alone = np.flatnonzero(label < 0)
    if len(alone):
        nearest = cKDTree(seeds).query(points[alone])[1]
        label[alone] = best[nearest]
        confidence[alone] = table[nearest, best[nearest]]
    return label, confidence
