"""Normalised cut of one group of voxels in two.

Weights reach metres, so the graph of a large cluster has nearly as many edges as pairs of voxels. The voxels are
therefore aggregated into nodes, the cells of a coarser grid. A node represents its voxels at their mean position, with
their number as its mass. The weight of two nodes is the product of their masses and the weight of equation 19. The
second eigenvector of the small dense graph is computed by Lanczos' method and extended to every voxel as the weighted
mean of the nodes' values (Nystrom's extension), so that the border is as fine as the voxels.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEPS = 60  # most steps of Lanczos' method
_CONVERGED = 1e-5


@njit(cache=True, nogil=True)
def weight(a: NDArray[np.float64], b: NDArray[np.float64], scale: NDArray[np.float64], max_squared: float) -> float:
    """Return the weight of two places (x, y, z, intensity), equation 19."""
    dx, dy, dz, di = a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]
    horizontal = dx * dx + dy * dy
    if horizontal > max_squared:
        return 0.0
    return np.exp(-(horizontal * scale[0] + dz * dz * scale[1] + di * di * scale[2]))


@njit(cache=True, nogil=True)
def _node_keys(
    places: NDArray[np.float64], members: NDArray[np.int64], low: NDArray[np.float64], size: float, shape: NDArray
) -> NDArray[np.int64]:
    keys = np.empty(len(members), np.int64)
    for k in range(len(members)):
        p = places[members[k]]
        key = np.int64(0)
        for axis in range(3):
            key = key * shape[axis] + np.int64((p[axis] - low[axis]) / size)
        keys[k] = key
    return keys


@njit(cache=True, nogil=True)
def gather(
    places: NDArray[np.float64], members: NDArray[np.int64], voxel_size: float, max_nodes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Aggregate voxels into at most `max_nodes` nodes."""
    n = len(members)
    if n <= max_nodes:
        nodes = np.empty((n, 4))
        for k in range(n):
            nodes[k] = places[members[k]]
        return nodes, np.ones(n)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for k in range(n):
        for axis in range(3):
            low[axis] = min(low[axis], places[members[k], axis])
            high[axis] = max(high[axis], places[members[k], axis])
    size = voxel_size * max(2.0, 0.7 * np.sqrt(n / max_nodes))
    while True:
        shape = np.empty(3, np.int64)
        for axis in range(3):
            shape[axis] = np.int64((high[axis] - low[axis]) / size) + 1
        keys = _node_keys(places, members, low, size, shape)
        order = np.argsort(keys, kind="mergesort")
        count = 1
        for k in range(1, n):
            count += keys[order[k]] != keys[order[k - 1]]
        if count <= max_nodes:
            break
        size *= 1.25
    nodes, mass = np.zeros((count, 4)), np.zeros(count)
    node = -1
    for k in range(n):
        if k == 0 or keys[order[k]] != keys[order[k - 1]]:
            node += 1
        mass[node] += 1.0
        nodes[node] += places[members[order[k]]]
    for node in range(count):
        nodes[node] /= mass[node]
    return nodes, mass


@njit(cache=True, nogil=True)
def node_weights(
    nodes: NDArray[np.float64], mass: NDArray[np.float64], scale: NDArray[np.float64], max_squared: float
) -> NDArray[np.float64]:
    """Return the dense matrix of weights between nodes, each with itself included."""
    n = len(nodes)
    weights = np.empty((n, n))
    for i in range(n):
        weights[i, i] = mass[i] * mass[i]
        for j in range(i):
            value = mass[i] * mass[j] * weight(nodes[i], nodes[j], scale, max_squared)
            weights[i, j] = value
            weights[j, i] = value
    return weights


@njit(cache=True, nogil=True)
def second_eigenvector(
    weights: NDArray[np.float64], degree: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return y of (D - W) y = (1 - eigenvalue) D y for the largest eigenvalue below 1, and the eigenvalue."""
    n = len(degree)
    root = np.sqrt(degree)
    first = root / np.sqrt(degree.sum())
    steps = min(_STEPS, n - 1)
    basis = np.zeros((steps, n))
    alpha, beta = np.zeros(steps), np.zeros(steps)
    q = start * root
    q -= (q @ first) * first
    norm = np.sqrt(q @ q)
    if norm < 1e-12 * np.sqrt(n):  # the initial guess is parallel to the first eigenvector
        for i in range(n):
            q[i] = (-1.0) ** i
        q -= (q @ first) * first
        norm = np.sqrt(q @ q)
    basis[0] = q / norm
    used = 1
    for k in range(steps):
        used = k + 1
        r = (weights @ (basis[k] / root)) / root
        alpha[k] = r @ basis[k]
        for _ in range(2):  # twice is enough to keep the basis orthogonal
            r -= (r @ first) * first
            for j in range(k + 1):
                r -= (r @ basis[j]) * basis[j]
        beta[k] = np.sqrt(r @ r)
        if k + 1 == steps or beta[k] < _CONVERGED * 1e-3:
            break
        if k >= 9 and k % 10 == 9:
            values, vectors = _tridiagonal(alpha[: k + 1], beta[:k])
            if abs(beta[k] * vectors[k, k]) < _CONVERGED:
                break
        basis[k + 1] = r / beta[k]
    values, vectors = _tridiagonal(alpha[:used], beta[: used - 1])
    y = np.zeros(n)
    for j in range(used):
        y += vectors[j, used - 1] * basis[j]
    return y / root, values[used - 1]


@njit(cache=True, nogil=True)
def _tridiagonal(
    alpha: NDArray[np.float64], beta: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    n = len(alpha)
    matrix = np.zeros((n, n))
    for i in range(n):
        matrix[i, i] = alpha[i]
        if i + 1 < n:
            matrix[i, i + 1] = beta[i]
            matrix[i + 1, i] = beta[i]
    return np.linalg.eigh(matrix)


@njit(cache=True, nogil=True)
def best_split(
    weights: NDArray[np.float64], degree: NDArray[np.float64], mass: NDArray[np.float64], y: NDArray, min_mass: float
) -> tuple[float, float]:
    """Return the value of y that splits the nodes with the least normalised cut, equation 20, and that cut."""
    order = np.argsort(y, kind="mergesort")
    total, all_mass = degree.sum(), mass.sum()
    inside, cut, held = 0.0, 0.0, 0.0
    least, threshold = np.inf, np.nan
    for k in range(len(order) - 1):
        i = order[k]
        to_inside = 0.0
        for j in range(k):
            to_inside += weights[i, order[j]]
        cut += degree[i] - weights[i, i] - 2.0 * to_inside
        inside += degree[i]
        held += mass[i]
        if held < min_mass or all_mass - held < min_mass or y[order[k + 1]] == y[i]:
            continue
        value = cut / inside + cut / (total - inside)
        if value < least:
            least, threshold = value, 0.5 * (y[i] + y[order[k + 1]])
    return threshold, least


@njit(cache=True, nogil=True)
def smoothness(y: NDArray[np.float64], mass: NDArray[np.float64], n_bins: int) -> float:
    """Return the ratio of the smallest to the largest bin of the histogram of the eigenvector's values."""
    low, high = y.min(), y.max()
    bins = np.zeros(n_bins)
    if not high > low:
        return 1.0
    for i in range(len(y)):
        bins[min(int((y[i] - low) / (high - low) * n_bins), n_bins - 1)] += mass[i]
    return bins.min() / bins.max()


@njit(cache=True, nogil=True)
def extend(
    places: NDArray[np.float64],
    members: NDArray[np.int64],
    nodes: NDArray[np.float64],
    mass: NDArray[np.float64],
    y: NDArray[np.float64],
    eigenvalue: float,
    scale: NDArray[np.float64],
    max_squared: float,
) -> NDArray[np.float64]:
    """Extend the nodes' values to voxels: the weighted mean over nodes, divided by the eigenvalue."""
    out = np.empty(len(members))
    for k in range(len(members)):
        above, below = 0.0, 0.0
        for c in range(len(nodes)):
            w = mass[c] * weight(places[members[k]], nodes[c], scale, max_squared)
            above += w * y[c]
            below += w
        if below > 0.0:
            out[k] = above / (below * eigenvalue)
            continue
        nearest = np.inf  # beyond the reach of every node
        for c in range(len(nodes)):
            away = ((places[members[k], :3] - nodes[c, :3]) ** 2).sum()
            if away < nearest:
                nearest, out[k] = away, y[c]
    return out
