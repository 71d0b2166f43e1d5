"""Compiled kernels of the voxel grid. A brick of 8 x 8 x 8 voxels is one hash-table entry with a bitmap.

The voxel of a point is found by one hash lookup of its brick (none if the previous point is in the same brick) and one
population count. Coordinates are quantised to 2^-20 of a voxel. All sums over points are sums of integers, and do not
depend on the order of the points or on the threads.
"""

from typing import Any

import numpy as np
from numba import njit, types
from numba.core.typing.templates import Signature
from numba.cpython.unsafe.numbers import trailing_zeros
from numba.extending import intrinsic
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import EMPTY, hash_key

FRACTION_BITS = 20
FRACTION_MASK = (1 << FRACTION_BITS) - 1
AXIS_BITS = 21  # three brick coordinates share one int64 key
AXIS_MASK = (1 << AXIS_BITS) - 1


@intrinsic
def popcount(typing_context: Any, word: Any) -> tuple[Signature, Any]:
    """Count the set bits of a uint64; usable in compiled code only."""
    if word != types.uint64:
        return None  # type: ignore[return-value]  # rejects other types

    def generate(context: Any, builder: Any, signature: Signature, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@njit(cache=True, nogil=True)
def _mark_cells(
    xyz: NDArray[np.floating],
    origin: NDArray[np.float64],
    scale: float,
    start: int,
    stop: int,
    slots: NDArray[np.int64],
    values: NDArray[np.int32],
    n_bricks: int,
    keys: NDArray[np.int64],
    bitmaps: NDArray[np.uint64],
    codes: NDArray[np.int32],
) -> tuple[int, int]:
    """Write codes of points until the table is half full; return the next point and the number of bricks."""
    ox, oy, oz = origin[0], origin[1], origin[2]
    mask = len(slots) - 1
    last_key, brick = np.int64(-1), np.int64(0)
    for i in range(start, stop):
        cx = np.int64((xyz[i, 0] - ox) * scale) >> FRACTION_BITS
        cy = np.int64((xyz[i, 1] - oy) * scale) >> FRACTION_BITS
        cz = np.int64((xyz[i, 2] - oz) * scale) >> FRACTION_BITS
        key = ((cx >> 3) << (2 * AXIS_BITS)) | ((cy >> 3) << AXIS_BITS) | (cz >> 3)
        if key != last_key:
            h = hash_key(key, mask)
            while slots[h] != key and slots[h] != EMPTY:
                h = (h + 1) & mask
            if slots[h] == EMPTY:
                if n_bricks == len(keys):
                    return i, n_bricks
                slots[h] = key
                values[h] = n_bricks
                keys[n_bricks] = key
                n_bricks += 1
            brick = np.int64(values[h])
            last_key = key
        cell = ((cx & 7) << 6) | ((cy & 7) << 3) | (cz & 7)
        codes[i] = np.int32((brick << 9) | cell)
        bitmaps[brick, cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)
    return stop, n_bricks


@njit(cache=True, nogil=True)
def assign_bricks(
    xyz: NDArray[np.floating],
    origin: NDArray[np.float64],
    scale: float,
    start: int,
    stop: int,
    codes: NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
    """Number the bricks of a range of points; write brick * 512 + cell of each point and mark the cells."""
    capacity = 4096
    keys = np.empty(capacity, np.int64)
    bitmaps = np.zeros((capacity, 8), np.uint64)
    n_bricks = np.int64(0)  # a literal would compile a second version
    i = start
    while True:
        slots = np.full(2 * capacity, EMPTY, np.int64)
        values = np.empty(2 * capacity, np.int32)
        for b in range(n_bricks):
            h = hash_key(keys[b], 2 * capacity - 1)
            while slots[h] != EMPTY:
                h = (h + 1) & (2 * capacity - 1)
            slots[h] = keys[b]
            values[h] = b
        i, n_bricks = _mark_cells(xyz, origin, scale, i, stop, slots, values, n_bricks, keys, bitmaps, codes)
        if i == stop:
            return keys[:n_bricks], bitmaps[:n_bricks]
        capacity *= 2
        more_keys, more_bitmaps = np.empty(capacity, np.int64), np.zeros((capacity, 8), np.uint64)
        for b in range(n_bricks):
            more_keys[b] = keys[b]
            for w in range(8):
                more_bitmaps[b, w] = bitmaps[b, w]
        keys, bitmaps = more_keys, more_bitmaps


@njit(cache=True, nogil=True)
def merge_bitmaps(merged: NDArray[np.uint64], bitmaps: NDArray[np.uint64], position: NDArray[np.int32]) -> None:
    """Merge the bitmaps of a range of points into those of the cloud."""
    for b in range(len(bitmaps)):
        for w in range(8):
            merged[position[b], w] |= bitmaps[b, w]


@njit(cache=True, nogil=True)
def number_voxels(keys: NDArray[np.int64], bitmaps: NDArray[np.uint64]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Number the voxels brick by brick; return the first voxel of each bitmap word and the voxel coordinates."""
    first = np.empty(bitmaps.shape, np.int32)
    n = 0
    for b in range(len(bitmaps)):
        for w in range(8):
            first[b, w] = n
            n += popcount(bitmaps[b, w])
    coords = np.empty((n, 3), np.int32)
    v = 0
    for b in range(len(keys)):
        x = (keys[b] >> (2 * AXIS_BITS)) << 3
        y = ((keys[b] >> AXIS_BITS) & AXIS_MASK) << 3
        z = (keys[b] & AXIS_MASK) << 3
        for w in range(8):
            word = bitmaps[b, w]
            while word != 0:
                bit = np.int64(trailing_zeros(word))
                coords[v, 0] = x + w
                coords[v, 1] = y + (bit >> 3)
                coords[v, 2] = z + (bit & 7)
                v += 1
                word &= word - np.uint64(1)
    return first, coords


@njit(cache=True, nogil=True)
def accumulate_points(
    xyz: NDArray[np.floating],
    origin: NDArray[np.float64],
    scale: float,
    start: int,
    stop: int,
    position: NDArray[np.int32],
    bitmaps: NDArray[np.uint64],
    first: NDArray[np.int32],
    voxel_of_point: NDArray[np.int32],
    sums: NDArray[np.int64],
) -> None:
    """Replace the codes in `voxel_of_point` by voxel ids, and sum (x, y, z, 1) over the points of each voxel."""
    ox, oy, oz = origin[0], origin[1], origin[2]
    for i in range(start, stop):
        code = voxel_of_point[i]
        brick = position[code >> 9]
        cell = code & 511
        below = (np.uint64(1) << np.uint64(cell & 63)) - np.uint64(1)
        v = first[brick, cell >> 6] + np.int32(popcount(bitmaps[brick, cell >> 6] & below))
        voxel_of_point[i] = v
        sums[v, 0] += np.int64((xyz[i, 0] - ox) * scale) & FRACTION_MASK
        sums[v, 1] += np.int64((xyz[i, 1] - oy) * scale) & FRACTION_MASK
        sums[v, 2] += np.int64((xyz[i, 2] - oz) * scale) & FRACTION_MASK
        sums[v, 3] += 1


@njit(cache=True, nogil=True)
def local_centroids(coords: NDArray[np.int32], sums: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the mean of the points of each voxel, in voxel sizes from the origin of the grid."""
    out = np.empty(coords.shape, np.float64)
    for v in range(len(coords)):
        weight = 1.0 / (np.float64(sums[v, 3]) * (1 << FRACTION_BITS))
        for axis in range(3):
            out[v, axis] = coords[v, axis] + sums[v, axis] * weight
    return out


@njit(cache=True, nogil=True)
def sort_points(voxel_of_point: NDArray[np.int32], indptr: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sort points by voxel, stably."""
    order = np.empty(len(voxel_of_point), np.int64)
    place = indptr[:-1].copy()
    for i in range(len(voxel_of_point)):
        v = voxel_of_point[i]
        order[place[v]] = i
        place[v] += 1
    return order
