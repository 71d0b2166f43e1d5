"""k-medoids clustering on a distance matrix (Yu et al. 2016, equation 18)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ITERATIONS = 20  # most iterations of assignment and update


@njit(cache=True, nogil=True)
def _first_centres(matrix: NDArray[np.float64], k: int, draws: NDArray[np.float64]) -> NDArray[np.int64]:
    """Draw up to k distant members as in k-means++; fewer where all others are at distance 0 of one of them."""
    n = len(matrix)
    centres = np.empty(k, np.int64)
    centres[0] = min(int(draws[0] * n), n - 1)
    nearest = matrix[:, centres[0]].copy()
    nearest[centres[0]] = 0.0
    for c in range(1, k):
        mark, seen, pick = draws[c] * nearest.sum(), 0.0, -1
        for i in range(n):
            seen += nearest[i]
            if nearest[i] > 0.0:
                pick = i
                if seen >= mark:
                    break
        if pick < 0:
            return centres[:c]
        centres[c] = pick
        nearest = np.minimum(nearest, matrix[:, pick])
        nearest[pick] = 0.0
    return centres


@njit(cache=True, nogil=True)
def _assign(matrix: NDArray[np.float64], centres: NDArray[np.int64], owner: NDArray[np.int64]) -> None:
    """Assign every member to its nearest centre; of equally near centres to the first."""
    for i in range(len(matrix)):
        least = np.inf
        for c in range(len(centres)):
            if matrix[i, centres[c]] < least:
                least, owner[i] = matrix[i, centres[c]], c


@njit(cache=True, nogil=True)
def central_members(matrix: NDArray[np.float64], k: int, draws: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return up to k centres; the centre of a cluster is the member of least sum of distances, equation 18."""
    centres = _first_centres(matrix, k, draws)
    owner = np.zeros(len(matrix), np.int64)
    for _ in range(_ITERATIONS):
        _assign(matrix, centres, owner)
        order = np.argsort(owner, kind="mergesort")
        starts = np.searchsorted(owner[order], np.arange(len(centres) + 1))
        before = centres.copy()
        for c in range(len(centres)):
            members = order[starts[c] : starts[c + 1]]
            least = np.inf
            for a in members:
                total = 0.0
                for b in members:
                    total += matrix[b, a]
                if total < least:
                    least, centres[c] = total, a
        if np.array_equal(before, centres):
            break
    return np.unique(centres)
