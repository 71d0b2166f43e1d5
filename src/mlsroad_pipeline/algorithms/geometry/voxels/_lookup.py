"""Compiled kernels for voxel lookup by coordinates and for voxel neighbours."""

import numpy as np
from numba import njit
from numba.cpython.unsafe.numbers import trailing_zeros
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import find_key
from mlsroad_pipeline.algorithms.geometry.voxels._bricks import AXIS_BITS, AXIS_MASK, popcount


@njit(cache=True, nogil=True)
def _fill_cube(
    cube: NDArray[np.int32], dx: int, dy: int, dz: int, bitmap: NDArray[np.uint64], first: NDArray[np.int32]
) -> None:
    """Write the ids of the voxels of a brick inside the 10 x 10 x 10 cube around the middle brick."""
    mask = ~np.uint64(0)
    if dy < 0:
        mask &= np.uint64(0xFF00000000000000)
    elif dy > 0:
        mask &= np.uint64(0x00000000000000FF)
    if dz < 0:
        mask &= np.uint64(0x8080808080808080)
    elif dz > 0:
        mask &= np.uint64(0x0101010101010101)
    w_start = 7 if dx < 0 else 0
    w_stop = 1 if dx > 0 else 8
    for w in range(w_start, w_stop):
        word = bitmap[w] & mask
        row = (w + 8 * dx + 1) * 100 + (8 * dy + 1) * 10 + 8 * dz + 1
        while word != 0:
            lowest = word & (~word + np.uint64(1))
            bit = np.int64(trailing_zeros(word))
            cube[row + (bit >> 3) * 10 + (bit & 7)] = first[w] + np.int32(popcount(bitmap[w] & (lowest - np.uint64(1))))
            word ^= lowest


@njit(cache=True, nogil=True)
def _fill_surroundings(
    cube: NDArray[np.int32],
    key: int,
    slots: NDArray[np.int64],
    values: NDArray[np.int32],
    bitmaps: NDArray[np.uint64],
    first: NDArray[np.int32],
) -> None:
    """Write the ids of the voxels of a brick and of those adjacent to it into the cube, -1 elsewhere."""
    cube[:] = -1
    bx, by, bz = key >> (2 * AXIS_BITS), (key >> AXIS_BITS) & AXIS_MASK, key & AXIS_MASK
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            for dz in range(-1, 2):
                x, y, z = bx + dx, by + dy, bz + dz
                if min(x, y, z) < 0 or max(x, y, z) > AXIS_MASK:
                    continue
                other = find_key(slots, values, (x << (2 * AXIS_BITS)) | (y << AXIS_BITS) | z)
                if other >= 0:
                    _fill_cube(cube, dx, dy, dz, bitmaps[other], first[other])


@njit(cache=True, nogil=True)
def neighbor_rows(
    keys: NDArray[np.int64],
    slots: NDArray[np.int64],
    values: NDArray[np.int32],
    bitmaps: NDArray[np.uint64],
    first: NDArray[np.int32],
    brick_start: int,
    brick_stop: int,
    v_start: int,
    v_stop: int,
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """List the occupied 26-neighbours of each voxel of a range of bricks, in (x, y, z) order of offsets."""
    offsets = np.empty(26, np.int64)
    k = 0
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            for dz in range(-1, 2):
                if dx != 0 or dy != 0 or dz != 0:
                    offsets[k] = dx * 100 + dy * 10 + dz
                    k += 1
    indptr = np.zeros(v_stop - v_start + 1, np.int64)
    indices = np.empty(26 * (v_stop - v_start) + 1, np.int32)
    cube = np.empty(1000, np.int32)
    v = position = 0
    for b in range(brick_start, brick_stop):
        _fill_surroundings(cube, keys[b], slots, values, bitmaps, first)
        for w in range(8):
            word = bitmaps[b, w]
            while word != 0:
                bit = np.int64(trailing_zeros(word))
                middle = (w + 1) * 100 + ((bit >> 3) + 1) * 10 + (bit & 7) + 1
                for k in range(26):
                    neighbor = cube[np.uint32(middle + offsets[k])]
                    indices[np.uint64(position)] = neighbor
                    position += neighbor >= 0
                v += 1
                indptr[v] = position
                word &= word - np.uint64(1)
    return indptr, indices[:position]


@njit(cache=True, nogil=True)
def look_up_voxels(
    coords: NDArray[np.int64],
    slots: NDArray[np.int64],
    values: NDArray[np.int32],
    bitmaps: NDArray[np.uint64],
    first: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Return the voxel at each triple of integer coordinates; -1 if it is empty."""
    out = np.full(len(coords), -1, np.int32)
    for i in range(len(coords)):
        x, y, z = coords[i, 0], coords[i, 1], coords[i, 2]
        if min(x, y, z) < 0 or max(x, y, z) >> (AXIS_BITS + 3) != 0:
            continue
        b = find_key(slots, values, ((x >> 3) << (2 * AXIS_BITS)) | ((y >> 3) << AXIS_BITS) | (z >> 3))
        if b >= 0:
            bit = np.uint64(1) << np.uint64(((y & 7) << 3) | (z & 7))
            word = bitmaps[b, x & 7]
            if word & bit != 0:
                out[i] = first[b, x & 7] + np.int32(popcount(word & (bit - np.uint64(1))))
    return out
