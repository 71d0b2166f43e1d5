"""Precomputed features of groups, and the discriminant group distance between them."""

from __future__ import annotations

from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class Context(NamedTuple):
    """Groups prepared for the distance."""

    # Whitened descriptors: the Mahalanobis distance of two features is the squared distance of two rows
    features: NDArray[np.float64]
    angle: NDArray[np.float64]  # ORel, equation 12, radians
    ratio: NDArray[np.float64]  # SRel, equation 13, in each matching order of `orders`


def orders(m: int) -> NDArray[np.int64]:
    """Return all matching orders of m features, (m!, m), the identity first."""
    return np.array(list(permutations(range(m))), dtype=np.int64)


def prepare(descriptors: NDArray, orientations: NDArray, scales: NDArray, whitening: NDArray[np.float64]) -> Context:
    """Prepare groups for the distance."""
    g, m = scales.shape
    features = descriptors.astype(np.float64) @ whitening
    axes, sizes = orientations.astype(np.float64), scales.astype(np.float64)
    angle, ratio = np.zeros(g), np.zeros((g, len(orders(m))))
    for x, y in combinations(range(m), 2):
        # Eigenvectors have no sign: the acute angle.
        angle += np.arccos(np.minimum(np.abs((axes[:, x] * axes[:, y]).sum(axis=1)), 1.0))
    for p, order in enumerate(orders(m)):
        for x, y in combinations(range(m), 2):
            ratio[:, p] += np.log1p(sizes[:, order[x]] / sizes[:, order[y]])
    return Context(np.ascontiguousarray(features), angle, ratio)


def sorted_features(context: Context) -> NDArray[np.float64]:
    """Return the features of each group with every coordinate sorted separately, (g, m * r).

    Of all pairings of two sets of numbers, the sorted one has the least sum of squared differences. The distance of
    these rows is therefore a lower bound of the distance of two groups in any matching order.
    """
    g, m, r = context.features.shape
    return np.sort(context.features, axis=1).reshape(g, m * r)


@njit(cache=True, nogil=True)
def ratio_similarity(a: float, b: float) -> float:
    """Return the ratio of minimum and maximum of two non-negative numbers (equations 14 and 15); 1 where both are 0."""
    low, high = min(a, b), max(a, b)
    return low / high if high > 0.0 else 1.0


@njit(cache=True, nogil=True)
def context_factor(angle: float, ratio: float, other_angle: float, other: NDArray[np.float64], floor: float) -> float:
    """Return 1 - SCSim of equation 11 under the best matching order, at least `floor`; 1 for groups of one region."""
    if len(other) == 1:
        return 1.0
    best = 0.0
    for p in range(len(other)):
        best = max(best, ratio_similarity(ratio, other[p]))
    return max(1.0 - 0.5 * (ratio_similarity(angle, other_angle) + best), floor)


@njit(cache=True, nogil=True)
def feature_distance(
    features: NDArray[np.float64], ratio: float, others: NDArray[np.float64], ratios: NDArray[np.float64],
    matching: NDArray[np.int64], limit: float,
) -> float:  # fmt: skip
    """Return the sum of equation 16 for the best matching order; the least sum of equally good orders."""
    best = 0.0
    for p in range(len(ratios)):
        best = max(best, ratio_similarity(ratio, ratios[p]))
    least = np.inf
    for p in range(len(ratios)):
        if ratio_similarity(ratio, ratios[p]) < best * (1.0 - 1e-12):
            continue
        total = 0.0
        for x in range(len(features)):
            row, other = features[x], others[matching[p, x]]
            for c in range(len(row)):
                total += (row[c] - other[c]) ** 2
            if total > limit and total > least:
                break
        least = min(least, total)
    return least
