"""Merging of superpoints into larger ones: greedy minimisation of the energy of the generalised minimal partition.

Robert et al. 2023, equation 1, with the greedy merging of Koepfler et al. 1994 in place of parallel cut pursuit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers


@njit(cache=True, nogil=True)
def _best_partners(
    values: NDArray, weights: NDArray, edges: NDArray, lengths: NDArray, regularisation: float
) -> NDArray[np.int64]:
    """Return for each region the best edge that lowers the energy, -1 without one; ties go to the lower edge."""
    gain = np.zeros(len(weights))
    best = np.full(len(weights), -1, np.int64)
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        squared = 0.0
        for k in range(values.shape[1]):
            squared += (values[a, k] - values[b, k]) ** 2
        saved = regularisation * lengths[e] - weights[a] * weights[b] / (weights[a] + weights[b]) * squared
        if saved > gain[a]:
            gain[a], best[a] = saved, e
        if saved > gain[b]:
            gain[b], best[b] = saved, e
    return best


def merge_regions(
    values: NDArray[np.floating],
    weights: NDArray[np.floating],
    edges: NDArray[np.integer],
    *,
    regularisation: float,
) -> NDArray[np.int32]:
    """Merge adjacent regions with similar values.

    The energy is the sum of the weighted squared distances of the regions from the mean of their group, plus
    `regularisation` for each edge between groups.
    """
    owner: NDArray[np.integer] = np.arange(len(weights))
    means, mass = np.array(values, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    pairs: NDArray[np.int64] = np.array(edges, dtype=np.int64).reshape(-1, 2)
    lengths: NDArray[Any] = np.ones(len(pairs))
    while True:
        best = _best_partners(means, mass, pairs, lengths, regularisation)
        chosen = pairs[rank_integers(best[best >= 0])[0]]
        mutual = chosen[best[chosen[:, 0]] == best[chosen[:, 1]]]
        if not len(mutual):
            return owner.astype(np.int32)
        head = np.arange(len(mass))
        head[mutual.max(axis=1)] = mutual.min(axis=1)
        _, group = rank_integers(head)
        total = np.bincount(group, mass).astype(np.float64)
        means = np.stack([np.bincount(group, mass * column) for column in means.T], axis=1) / total[:, None]
        mass, owner = total, group[owner]
        pairs, lengths = _contract(group[pairs].astype(np.int64), lengths, len(mass))


def _contract(pairs: NDArray[np.int64], lengths: NDArray[Any], n: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Drop edges within a group and sum those between the same two groups."""
    between = pairs[:, 0] != pairs[:, 1]
    pairs = np.sort(pairs[between], axis=1)
    keys, row = rank_integers(pairs[:, 0] * n + pairs[:, 1])
    ends: NDArray[np.int64] = np.stack([keys // n, keys % n], axis=1)
    return ends, np.bincount(row, lengths[between], minlength=len(keys))
