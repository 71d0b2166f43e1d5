"""Discriminant group distance, equation by equation, and planted bags of words."""

from itertools import permutations

import numpy as np
from scipy.sparse import csr_array


def distance(group, word, inverse, floor):
    """Equation 16 of one group and one word, each (descriptors (m, d), orientations (m, 3), scales (m,)).

    Returns the distance and the sum of Mahalanobis distances under the chosen matching order.
    """
    descriptors, orientations, scales = (np.asarray(part, dtype=np.float64) for part in group)
    others, directions, sizes = (np.asarray(part, dtype=np.float64) for part in word)
    m = len(scales)

    def orientation_relation(axes):
        pairs = [(x, y) for x in range(m) for y in range(x + 1, m)]
        return sum(np.arccos(min(abs(axes[x] @ axes[y]), 1.0)) for x, y in pairs)

    def scale_relation(values):
        return sum(np.log(1 + values[x] / values[y]) for x in range(m) for y in range(x + 1, m))

    def similarity(a, b):
        return min(a, b) / max(a, b) if max(a, b) > 0 else 1.0

    found = []
    for order in map(list, permutations(range(m))):
        turned = similarity(orientation_relation(orientations), orientation_relation(directions[order]))
        scaled = similarity(scale_relation(scales), scale_relation(sizes[order]))
        off = [descriptors[x] - others[order[x]] for x in range(m)]
        found.append((0.5 * (turned + scaled), sum(d @ inverse @ d for d in off)))
    best = max(similarity for similarity, _ in found)
    total = min(value for similarity, value in found if similarity >= best - 1e-10)
    factor = 1.0 if m == 1 else max(1 - best, floor)
    return factor * total, total


def planted(rng, n):
    """Objects of two classes, each with two kinds of words of its own, and others; all share some words."""
    kind = rng.integers(0, 5, n)
    rate = np.full((5, 60), 0.15)
    for k in range(5):
        rate[k, 10 * k : 10 * k + 10] = 4.0
    labels = np.array([0, 0, 1, 1, -1])[kind]
    return csr_array(rng.poisson(rate[kind]).astype(np.float64)), labels
