"""Compiled kernels of seed selection: one voxel per occupied cell of the seed grid, with filters."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import EMPTY, hash_key
from mlsroad_pipeline.algorithms.geometry.voxels._bricks import AXIS_BITS

CELL_OFFSET = 1 << (AXIS_BITS - 1)


@njit(cache=True, nogil=True)
def _highest_bit_below(a: int, b: int) -> bool:
    """Return whether the highest set bit of a is lower than that of b."""
    return a < b and a < (a ^ b)


@njit(cache=True, nogil=True)
def first_in_octree(coords: NDArray[np.int32]) -> int:
    """Return the first voxel of a depth-first traversal of the octree around the centre of the cloud."""
    half = np.empty(3, np.int64)
    for axis in range(3):
        highest = np.int64(coords[0, axis])
        for v in range(1, len(coords)):
            highest = max(highest, np.int64(coords[v, axis]))
        half[axis] = (highest + 1) // 2
    offset = 1 << 24
    best = 0
    for v in range(1, len(coords)):
        deciding, highest = 0, np.int64(0)
        for axis in range(3):  # the axis of the highest differing bit decides; x before y and z
            differing = (coords[v, axis] - half[axis] + offset) ^ (coords[best, axis] - half[axis] + offset)
            if _highest_bit_below(highest, differing):
                deciding, highest = axis, differing
        if coords[v, deciding] < coords[best, deciding]:
            best = v
    return best


@njit(cache=True, nogil=True)
def _scan_cells(
    features: NDArray[np.float64],
    anchor: NDArray[np.float64],
    seed_size: float,
    start: int,
    slots: NDArray[np.int64],
    nearest: NDArray[np.int32],
    distance: NDArray[np.float64],
    n_cells: int,
) -> tuple[int, int]:
    """Keep the voxel nearest to the centre of each cell until the table is half full; return the next voxel."""
    mask = len(slots) - 1
    inverse = 1.0 / seed_size
    for v in range(start, len(features)):
        x = (features[v, 0] - anchor[0]) * inverse
        y = (features[v, 1] - anchor[1]) * inverse
        z = (features[v, 2] - anchor[2]) * inverse
        cx, cy, cz = np.floor(x), np.floor(y), np.floor(z)
        key = (
            ((np.int64(cx) + CELL_OFFSET) << (2 * AXIS_BITS))
            | ((np.int64(cy) + CELL_OFFSET) << AXIS_BITS)
            | (np.int64(cz) + CELL_OFFSET)
        )
        x, y, z = x - cx - 0.5, y - cy - 0.5, z - cz - 0.5
        squared = x * x + y * y + z * z
        h = hash_key(key, mask)
        while slots[h] != key and slots[h] != EMPTY:
            h = (h + 1) & mask
        if slots[h] == EMPTY:
            if 2 * n_cells > mask:
                return v, n_cells
            slots[h] = key
            nearest[h] = v
            distance[h] = squared
            n_cells += 1
        elif squared < distance[h]:  # ties go to the first voxel
            nearest[h] = v
            distance[h] = squared
    return len(features), n_cells


@njit(cache=True, nogil=True)
def nearest_to_cell_centres(
    features: NDArray[np.float64], anchor: NDArray[np.float64], seed_size: float
) -> NDArray[np.int32]:
    """Return the voxel nearest to the centre of each occupied seed cell, in ascending order."""
    size = 1024
    while size * seed_size * seed_size < 2.0 * len(features):
        size *= 2
    slots = np.full(size, EMPTY, np.int64)
    nearest = np.empty(size, np.int32)
    distance = np.empty(size, np.float64)
    v = n_cells = np.int64(0)  # literals would compile a second version
    v, n_cells = _scan_cells(features, anchor, seed_size, v, slots, nearest, distance, n_cells)
    while v < len(features):
        old_slots, old_nearest, old_distance = slots, nearest, distance
        size *= 2
        slots = np.full(size, EMPTY, np.int64)
        nearest = np.empty(size, np.int32)
        distance = np.empty(size, np.float64)
        for k in range(len(old_slots)):
            if old_slots[k] != EMPTY:
                h = hash_key(old_slots[k], size - 1)
                while slots[h] != EMPTY:
                    h = (h + 1) & (size - 1)
                slots[h], nearest[h], distance[h] = old_slots[k], old_nearest[k], old_distance[k]
        v, n_cells = _scan_cells(features, anchor, seed_size, v, slots, nearest, distance, n_cells)
    chosen = np.zeros(len(features), np.bool_)
    for k in range(size):
        if slots[k] != EMPTY:
            chosen[nearest[k]] = True
    seeds = np.empty(n_cells, np.int32)
    n = 0
    for u in range(len(features)):
        if chosen[u]:
            seeds[n] = u
            n += 1
    return seeds


@njit(cache=True, nogil=True)
def has_connected_voxels(
    seed: int,
    features: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    radius: float,
    needed: int,
    reached: NDArray[np.int64],
) -> bool:
    """Return whether at least `needed` voxels within the radius, including the seed, are connected to the seed."""
    reached[0] = seed
    n, i = 1, 0
    while i < n < needed:
        for k in range(indptr[reached[i]], indptr[reached[i] + 1]):
            u = indices[k]
            x, y, z = (
                features[u, 0] - features[seed, 0],
                features[u, 1] - features[seed, 1],
                features[u, 2] - features[seed, 2],
            )
            if x * x + y * y + z * z > radius * radius:
                continue
            known = False
            for j in range(n):
                known |= reached[j] == u
            if not known and n < needed:
                reached[n] = u
                n += 1
        i += 1
    return n >= needed


@njit(cache=True, nogil=True)
def spread_out(
    seeds: NDArray[np.int32],
    features: NDArray[np.float64],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    radius: float,
    needed: int,
    owner: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Remove seeds with too few connected voxels or adjacent to an earlier seed; number the others in `owner`."""
    kept = np.empty(len(seeds), np.int32)
    reached = np.empty(max(needed, 1), np.int64)
    n = 0
    for s in range(len(seeds)):
        v = seeds[s]
        free = True
        for k in range(indptr[v], indptr[v + 1]):
            if owner[indices[k]] >= 0:
                free = False
                break
        if free and (needed <= 1 or has_connected_voxels(v, features, indptr, indices, radius, needed, reached)):
            kept[n] = v
            owner[v] = n
            n += 1
    return kept[:n]


@njit(cache=True, nogil=True)
def drop_slivers(
    seeds: NDArray[np.int32],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
    largest: float,
) -> NDArray[np.int32]:
    """Remove seeds of at most `largest` voxels after one level, all adjacent to voxels of earlier seeds."""
    alive = np.ones(len(seeds), np.bool_)
    for s in range(len(seeds)):
        size = 0
        inner = False
        for q in range(indptr[seeds[s]] - 1, indptr[seeds[s] + 1]):
            w = seeds[s] if q < indptr[seeds[s]] else indices[q]
            if owner[w] != s:
                continue
            size += 1
            if inner:
                continue
            inner = True
            for k in range(indptr[w], indptr[w + 1]):
                t = owner[indices[k]]
                if 0 <= t < s and alive[t]:
                    inner = False
                    break
        alive[s] = inner or size > largest
    n = 0
    kept = np.empty(len(seeds), np.int32)
    for s in range(len(seeds)):
        if alive[s]:
            kept[n] = seeds[s]
            n += 1
    return kept[:n]
