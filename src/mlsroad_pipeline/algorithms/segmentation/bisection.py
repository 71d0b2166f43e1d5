"""Recursive normalised cuts of clusters of voxels.

Weights reach metres, so the graph of a large cluster has nearly as many edges as pairs of voxels. The voxels are
therefore aggregated into nodes, the cells of a coarser grid. A node represents its voxels at their mean position, with
their number as its mass. The weight of two nodes is the product of their masses and the weight of equation 19. The
second eigenvector of the small dense graph is computed by Lanczos' method and extended to every voxel as the weighted
mean of the nodes' values (Nystrom's extension), so that the border is as fine as the voxels.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_BINS = 12  # of the histogram of an eigenvector's values
_LEAST_EIGENVALUE = 1e-3  # below, the graph is disconnected and the extension undefined
_STEPS = 60  # most steps of Lanczos' method
_CONVERGED = 1e-5


@njit(cache=True, nogil=True)
def _weight(a: NDArray[np.float64], b: NDArray[np.float64], scale: NDArray[np.float64], max_squared: float) -> float:
    """Return the weight of two places (x, y, z, intensity), equation 19."""
    dx, dy, dz, di = a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]
    horizontal = dx * dx + dy * dy
    if horizontal > max_squared:
        return 0.0
    return np.exp(-(horizontal * scale[0] + dz * dz * scale[1] + di * di * scale[2]))


@njit(cache=True, nogil=True)
def gather(
    places: NDArray[np.float64], members: NDArray[np.int64], voxel_size: float, max_nodes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Aggregate voxels into at most `max_nodes` nodes; return their mean places and their numbers of voxels."""
    mine, n = places[members], len(members)
    if n <= max_nodes:
        return mine, np.ones(n)
    size = voxel_size * max(2.0, 0.7 * np.sqrt(n / max_nodes))
    while True:
        keys = np.zeros(n, np.int64)
        for axis in range(3):
            low = mine[:, axis].min()
            keys = keys * (np.int64((mine[:, axis].max() - low) / size) + 1)
            keys += ((mine[:, axis] - low) / size).astype(np.int64)
        order = np.argsort(keys, kind="mergesort")
        first = np.ones(n, np.bool_)
        first[1:] = keys[order[1:]] != keys[order[:-1]]
        if first.sum() <= max_nodes:
            break
        size *= 1.25
    nodes, mass = np.zeros((first.sum(), 4)), np.zeros(first.sum())
    node = -1
    for k in range(n):
        node += first[k]
        mass[node] += 1.0
        nodes[node] += mine[order[k]]
    for node in range(len(mass)):
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
            value = mass[i] * mass[j] * _weight(nodes[i], nodes[j], scale, max_squared)
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
    if np.sqrt(q @ q) < 1e-12 * np.sqrt(n):  # the initial guess is parallel to the first eigenvector
        q[:] = (-1.0) ** np.arange(n)
        q -= (q @ first) * first
    basis[0] = q / np.sqrt(q @ q)
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
    """Return eigenvalues and eigenvectors of the symmetric matrix with this diagonal and these values beside it."""
    return np.linalg.eigh(np.diag(alpha) + np.diag(beta, 1) + np.diag(beta, -1))


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
def _smoothness(y: NDArray[np.float64], mass: NDArray[np.float64]) -> float:
    """Return the ratio of the smallest to the largest bin of the histogram of the eigenvector's values."""
    low, high = y.min(), y.max()
    bins = np.zeros(_BINS)
    if not high > low:
        return 1.0
    for i in range(len(y)):
        bins[min(int((y[i] - low) / (high - low) * _BINS), _BINS - 1)] += mass[i]
    return bins.min() / bins.max()


@njit(cache=True, nogil=True)
def _extend(
    places: NDArray[np.float64], members: NDArray[np.int64], nodes: NDArray[np.float64], mass: NDArray[np.float64],
    y: NDArray[np.float64], eigenvalue: float, scale: NDArray[np.float64], max_squared: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Extend the nodes' values to voxels: the weighted mean over nodes, divided by the eigenvalue."""
    out = np.empty(len(members))
    for k in range(len(members)):
        above, below = 0.0, 0.0
        for c in range(len(nodes)):
            w = mass[c] * _weight(places[members[k]], nodes[c], scale, max_squared)
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


@njit(cache=True, nogil=True)
def cut_clusters(
    low_places: NDArray[np.float64], tall_places: NDArray[np.float64], order: NDArray[np.int64],
    starts: NDArray[np.int64], low_height: float, scales: NDArray[np.float64], max_cuts: NDArray[np.float64],
    max_squared: float, voxel_size: float, max_smoothness: float, min_voxels: int, max_nodes: int,
) -> NDArray[np.int64]:  # fmt: skip
    """Return the part of each voxel; the voxels of a part become consecutive in `order`.

    Groups no higher than `low_height` compare the intensities of `low_places` at each of the scales until a cut is
    found; others compare those of `tall_places` at the first scale.
    """
    parts = np.empty(len(low_places), np.int64)
    n_parts = 0
    for c in range(len(starts) - 1):
        stack = [(starts[c], starts[c + 1])]
        while len(stack) > 0:
            first, stop = stack.pop()
            members = order[first:stop].copy()
            low = len(members) > 0 and np.ptp(low_places[members, 2]) <= low_height
            places, side = low_places if low else tall_places, np.zeros(len(members), np.bool_)
            for k in range(len(scales) if low else 1):
                if not side.any():
                    side = _bisect(
                        places, members, scales[k], max_cuts[k], max_squared, voxel_size, max_smoothness, min_voxels,
                        max_nodes,
                    )  # fmt: skip
            n_left = np.int64(side.sum())
            if n_left == 0:
                parts[members] = n_parts
                n_parts += 1
                continue
            order[first : first + n_left], order[first + n_left : stop] = members[side], members[~side]
            stack.append((first, first + n_left))
            stack.append((first + n_left, stop))
    return parts


@njit(cache=True, nogil=True)
def _bisect(
    places: NDArray[np.float64], members: NDArray[np.int64], scale: NDArray[np.float64], max_cut: float,
    max_squared: float, voxel_size: float, max_smoothness: float, min_voxels: int, max_nodes: int,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return which voxels are on one side of the best cut; none where the group remains whole."""
    whole = np.zeros(len(members), np.bool_)
    if len(members) < 2 * min_voxels:
        return whole
    nodes, mass = gather(places, members, voxel_size, max_nodes)
    if len(nodes) < 2:
        return whole
    weights = node_weights(nodes, mass, scale, max_squared)
    degree = weights.sum(axis=1)
    y, eigenvalue = second_eigenvector(weights, degree, nodes[:, 0] - nodes[:, 0].mean() + 0.7 * nodes[:, 1])
    if eigenvalue < _LEAST_EIGENVALUE or _smoothness(y, mass) > max_smoothness:
        return whole
    threshold, cut = best_split(weights, degree, mass, y, float(min_voxels))
    if not cut <= max_cut:
        return whole
    if len(nodes) < len(members):
        y = _extend(places, members, nodes, mass, y, eigenvalue, scale, max_squared)
    side = y <= threshold
    return side if min(side.sum(), len(members) - side.sum()) >= min_voxels else whole
