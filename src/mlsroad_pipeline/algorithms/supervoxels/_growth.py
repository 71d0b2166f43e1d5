"""Compiled kernels of supervoxel growth: each voxel takes the nearest supervoxel of its neighbours, level by level.

Every level reads the owners of the previous level and writes new ones. The result is thus independent of the order of
the voxels and of the threads. Features are x, y, z (voxel sizes), the normal, and red, green and blue in [0, 1].
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

N_FEATURES = 9


@njit(cache=True, nogil=True, inline="always")
def squared_distance(
    models: NDArray[np.float64], model: int, features: NDArray[np.float64], voxel: int, weights: NDArray[np.float64]
) -> float:
    """Return D^2 (equation 1) between a supervoxel and a voxel; the weights include the normalisation."""
    s, v = np.uint32(model), np.uint32(voxel)  # unsigned: no test for negative indices
    x, y, z = models[s, 0] - features[v, 0], models[s, 1] - features[v, 1], models[s, 2] - features[v, 2]
    dot = models[s, 3] * features[v, 3] + models[s, 4] * features[v, 4] + models[s, 5] * features[v, 5]
    turned = 1.0 - abs(dot)
    total = weights[0] * (x * x + y * y + z * z) + weights[1] * turned * turned
    if weights[2] > 0.0:
        x, y, z = models[s, 6] - features[v, 6], models[s, 7] - features[v, 7], models[s, 8] - features[v, 8]
        total += weights[2] * (x * x + y * y + z * z)
    return total


@njit(cache=True, nogil=True, inline="always")
def nearest_supervoxel(
    v: int,
    features: NDArray[np.float64],
    models: NDArray[np.float64],
    weights: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
    candidates: NDArray[np.int32],
) -> np.int32:
    """Return the nearest supervoxel of the neighbours; ties go to the own one, then to the lower number."""
    own = owner[v]
    n = 0
    for k in range(indptr[v], indptr[v + 1]):  # branch-free: invalid candidates are overwritten
        s = owner[np.uint32(indices[k])]
        candidates[np.uint32(n)] = s
        n += (s >= 0) & (s != own)
    best, smallest = np.int32(-1), np.inf
    for i in range(n):
        s = candidates[np.uint32(i)]
        d = squared_distance(models, s, features, v, weights)
        if d < smallest or (d == smallest and s < best):
            smallest, best = d, s
    if own >= 0 and (n == 0 or smallest >= squared_distance(models, own, features, v, weights)):
        best = own
    return best


@njit(cache=True, nogil=True)
def first_level(
    seeds: NDArray[np.int32],
    features: NDArray[np.float64],
    weights: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Return the owners after the first level, as with `grow_level`, except that seeds keep their own voxel.

    Only the neighbours of the seeds are visited.
    """
    owner = np.full(len(features), -1, np.int32)
    distance = np.empty(len(features), np.float64)
    for s in range(len(seeds)):
        v = seeds[s]
        for k in range(indptr[v], indptr[v + 1]):
            u = indices[k]
            d = squared_distance(features, v, features, u, weights)
            if owner[u] < 0 or d < distance[u]:  # seeds are ascending: ties go to the lower
                owner[u] = s
                distance[u] = d
    for s in range(len(seeds)):
        owner[seeds[s]] = s
    return owner


@njit(cache=True, nogil=True)
def grow_level(
    features: NDArray[np.float64],
    models: NDArray[np.float64],
    weights: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
    start: int,
    stop: int,
    new_owner: NDArray[np.int32],
) -> None:
    """Write the supervoxel of each voxel of a range for the next level."""
    candidates = np.empty(27, np.int32)
    for v in range(start, stop):
        new_owner[v] = nearest_supervoxel(v, features, models, weights, indptr, indices, owner, candidates)


@njit(cache=True, nogil=True)
def update_models(
    features: NDArray[np.float64], owner: NDArray[np.int32], models: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean position, colour and normal direction of the voxels of each supervoxel.

    Normals have no sign: each is oriented to the previous normal of the supervoxel before the sum. A supervoxel without
    voxels keeps its previous values.
    """
    updated = np.zeros(models.shape, np.float64)
    counts = np.zeros(len(models), np.int64)
    for v in range(len(features)):
        s = owner[v]
        if s < 0:
            continue
        counts[s] += 1
        dot = models[s, 3] * features[v, 3] + models[s, 4] * features[v, 4] + models[s, 5] * features[v, 5]
        sign = -1.0 if dot < 0.0 else 1.0
        for j in range(3):
            updated[s, j] += features[v, j]
            updated[s, j + 3] += sign * features[v, j + 3]
        for j in range(6, features.shape[1]):
            updated[s, j] += features[v, j]
    for s in range(len(models)):
        if counts[s] == 0:
            for j in range(features.shape[1]):
                updated[s, j] = models[s, j]
            continue
        n = 1.0 / counts[s]
        length = np.sqrt(updated[s, 3] ** 2 + updated[s, 4] ** 2 + updated[s, 5] ** 2)
        turn = 1.0 / length if length > 0.0 else 0.0
        for j in range(features.shape[1]):
            updated[s, j] *= turn if 3 <= j < 6 else n
    return updated


@njit(cache=True, nogil=True)
def nearest_voxels(
    features: NDArray[np.float64], owner: NDArray[np.int32], models: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Return the voxel nearest to the centroid of each supervoxel, the first of equals; -1 without voxels."""
    nearest = np.full(len(models), -1, np.int32)
    distance = np.full(len(models), np.inf, np.float64)
    for v in range(len(features)):
        s = owner[v]
        if s < 0:
            continue
        x, y, z = features[v, 0] - models[s, 0], features[v, 1] - models[s, 1], features[v, 2] - models[s, 2]
        squared = x * x + y * y + z * z
        if squared < distance[s]:
            distance[s] = squared
            nearest[s] = v
    return nearest


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], v: int) -> int:
    """Return the root of the component of a voxel, with path halving."""
    while parent[v] != v:
        parent[v] = parent[parent[v]]
        v = parent[v]
    return v


@njit(cache=True, nogil=True)
def release_fragments(
    indptr: NDArray[np.int64], indices: NDArray[np.int32], owner: NDArray[np.int32], n_supervoxels: int
) -> NDArray[np.int32]:
    """Release voxels outside the largest connected component of their supervoxel; return all free voxels."""
    n = len(owner)
    parent = np.arange(n).astype(np.int32)
    for v in range(n):
        s = owner[v]
        if s < 0:
            continue
        here = v
        for k in range(indptr[v], indptr[v + 1]):
            u = indices[k]
            if u < v and owner[u] == s and parent[u] != here:
                there = _root(parent, u)
                if there < here:
                    parent[here] = there
                    here = there
                elif here < there:
                    parent[there] = here
    size = np.zeros(n, np.int32)
    for v in range(n):
        size[_root(parent, v)] += 1
    largest = np.full(n_supervoxels, -1, np.int32)
    for v in range(n):
        s = owner[v]
        if s >= 0 and parent[v] == v and (largest[s] < 0 or size[v] > size[largest[s]]):
            largest[s] = v
    free = np.empty(n, np.int32)
    n_free = 0
    for v in range(n):
        if owner[v] < 0 or _root(parent, v) != largest[owner[v]]:
            owner[v] = -1
            free[n_free] = v
            n_free += 1
    return free[:n_free].copy()


@njit(cache=True, nogil=True)
def flood(
    free: NDArray[np.int32],
    features: NDArray[np.float64],
    models: NDArray[np.float64],
    weights: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Assign free voxels to the nearest adjacent supervoxel, level by level; return unreached voxels."""
    left = free.copy()
    candidates = np.empty(27, np.int32)
    while len(left) > 0:
        choice = np.empty(len(left), np.int32)
        for i in range(len(left)):
            choice[i] = nearest_supervoxel(left[i], features, models, weights, indptr, indices, owner, candidates)
        n_left = 0
        for i in range(len(left)):
            if choice[i] >= 0:
                owner[left[i]] = choice[i]
            else:
                left[n_left] = left[i]
                n_left += 1
        if n_left == len(left):
            break
        left = left[:n_left]
    return left


@njit(cache=True, nogil=True)
def number_unreached(
    left: NDArray[np.int32],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
    first_number: int,
) -> int:
    """Make each connected component of unreached voxels a supervoxel; return their number."""
    number = first_number
    stack = np.empty(len(left), np.int32)
    for i in range(len(left)):
        if owner[left[i]] >= 0:
            continue
        owner[left[i]] = number
        stack[0] = left[i]
        depth = 1
        while depth > 0:
            depth -= 1
            v = stack[depth]
            for k in range(indptr[v], indptr[v + 1]):
                u = indices[k]
                if owner[u] < 0:
                    owner[u] = number
                    stack[depth] = u
                    depth += 1
        number += 1
    return number - first_number
