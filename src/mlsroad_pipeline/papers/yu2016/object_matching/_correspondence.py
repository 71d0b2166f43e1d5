"""Kernel of the object matching: correspondences between the parts of a prototype and of a candidate."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def _unlike(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Return the mean of the differences in shape, histogram and intensity, each from 0 to 1."""
    shape, histogram = 0.0, 0.0
    for k in range(3):
        shape += abs(one[k] - other[k])
    for k in range(3, 19):
        histogram += abs(one[k] - other[k])
    return (0.5 * shape + 0.5 * histogram + abs(one[19] - other[19])) / 3.0


@njit(cache=True, nogil=True)
def _assign(
    predicted: NDArray[np.float64],
    centres: NDArray[np.float64],
    unlike: NDArray[np.float64],
    i: int,
    taken: NDArray[np.bool_],
    share: float,
    reach: float,
    limit: float,
) -> tuple[int, float]:
    """Return the free part of least cost for a part of the prototype, and the cost; -1 for none below `limit`."""
    best, cost = -1, limit
    inverse = (1.0 - share) / reach
    for j in range(len(centres)):
        if taken[j]:
            continue
        total = share * unlike[i, j]
        if total >= cost:
            continue
        dx, dy, dz = predicted[0] - centres[j, 0], predicted[1] - centres[j, 1], predicted[2] - centres[j, 2]
        total += inverse * min(np.sqrt(dx * dx + dy * dy + dz * dz), reach)
        if total < cost:
            best, cost = j, total
    return best, cost


@njit(cache=True, nogil=True)
def _match(
    prototype: NDArray[np.float64],
    around: NDArray[np.int64],
    weights: NDArray[np.float64],
    centres: NDArray[np.float64],
    unlike: NDArray[np.float64],
    turns: NDArray[np.float64],
    share: float,
    reach: float,
    limit: float,
    n_sweeps: int,
) -> float:
    """Return the soft share of corresponding parts, the largest over all rotations about the vertical."""
    n, m = len(prototype), len(centres)
    place, x_hat = np.empty((n, 3)), np.empty(3)
    match, taken = np.empty(n, np.int64), np.empty(m, np.bool_)
    best = 0.0
    for t in range(len(turns)):
        cosine, sine = np.cos(turns[t]), np.sin(turns[t])
        taken[:] = False
        for i in range(n):
            place[i, 0] = cosine * prototype[i, 0] - sine * prototype[i, 1]
            place[i, 1] = sine * prototype[i, 0] + cosine * prototype[i, 1]
            place[i, 2] = prototype[i, 2]
            match[i] = -1
        for sweep in range(n_sweeps + 1):
            gain, pairs = 0.0, 0
            for i in range(n):
                if match[i] >= 0:
                    taken[match[i]] = False
                if sweep == 0:
                    x_hat[:] = place[i]
                else:
                    x_hat[:] = 0.0
                    for k in range(around.shape[1]):
                        for axis in range(3):
                            x_hat[axis] += weights[i, k] * place[around[i, k], axis]
                j, cost = _assign(x_hat, centres, unlike, i, taken, share, reach, limit)
                match[i] = j
                if j >= 0:
                    taken[j] = True
                    gain += 1.0 - cost / limit
                    pairs += 1
                    place[i] = centres[j]
                else:
                    place[i] = x_hat
            best = max(best, gain / (n + m - pairs))
    return best


@njit(cache=True, nogil=True)
def match_objects(
    prototypes: NDArray[np.float64],
    prototype_descriptors: NDArray[np.float32],
    prototype_bounds: NDArray[np.int64],
    around: NDArray[np.int64],
    weights: NDArray[np.float64],
    centres: NDArray[np.float64],
    descriptors: NDArray[np.float32],
    bounds: NDArray[np.int64],
    turns: NDArray[np.float64],
    share: float,
    reach: float,
    limit: float,
    n_sweeps: int,
    least: float,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write the similarity of objects `start` to `stop` to each prototype; 0 where their sizes differ too much."""
    for o in range(start, stop):
        mine = slice(bounds[o], bounds[o + 1])
        m = bounds[o + 1] - bounds[o]
        for p in range(out.shape[1]):
            first, last = prototype_bounds[p], prototype_bounds[p + 1]
            n = last - first
            if min(n, m) < least * max(n, m) or m == 0:
                continue
            unlike = np.empty((n, m))
            for i in range(n):
                for j in range(m):
                    unlike[i, j] = _unlike(prototype_descriptors[first + i], descriptors[bounds[o] + j])
            out[o, p] = _match(
                prototypes[first:last], around[first:last], weights[first:last], centres[mine], unlike, turns,
                share, reach, limit, n_sweeps,
            )  # fmt: skip
