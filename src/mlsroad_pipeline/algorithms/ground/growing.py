"""Kernels of upward growing on bit columns: one 64-bit word per column, one bit per voxel above the reference.

The region of a voxel is reached layer by layer through the nine upper neighbours. A flood fill is not needed: a region
climbs k layers if its voxel is occupied and an upper neighbour climbs k - 1. For the 64 voxels of a word this takes
three ORs and a shift.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.ground.blocks import NOWHERE, Lookup, Span, find_block

LAYERS = 64
"""Voxels of a column above the reference, one bit each."""


@njit(cache=True, nogil=True)
def occupy(
    xyz: NDArray[np.floating], span: Span, lookup: Lookup, surface: NDArray[np.float32], masks: NDArray[np.uint64]
) -> None:
    """Set the bit of the voxel of each point, counted from the surface.

    Points below the surface are in layer 0; points above the last layer are ignored.
    """
    x0, y0, z0, per_metre, n_columns, _ = lookup[0]
    per_layer = np.float32(per_metre)
    slot, corner_x, corner_y = 0, NOWHERE, NOWHERE
    for i in range(span[0], span[1]):
        ix = int((np.float64(xyz[i, 0]) - x0) * per_metre)
        iy = int((np.float64(xyz[i, 1]) - y0) * per_metre)
        if not (0 <= ix - corner_x < n_columns and 0 <= iy - corner_y < n_columns):
            slot, corner_x, corner_y = find_block(ix, iy, lookup)
        y, x = iy - corner_y, ix - corner_x
        level = (np.float32(np.float64(xyz[i, 2]) - z0) - surface[slot, y, x]) * per_layer
        if level < LAYERS:
            masks[slot, y, x] |= np.uint64(1) << np.uint64(max(level, np.float32(0)))


@njit(cache=True)
def _spread(masks: NDArray[np.uint64], around: NDArray[np.int32], block: int, padded: NDArray[np.uint64]) -> None:
    """Fill `padded` (side + 2, side + 2) with the words of a block and the border of its neighbours; OR over 3 x 3."""
    side = masks.shape[1]
    for y in range(side + 2):
        for x in range(side + 2):
            inside = 0 < y <= side and 0 < x <= side
            padded[y, x] = masks[block, y - 1, x - 1] if inside else np.uint64(0)
    for d in range(9):
        slot = around[block, d]
        if d == 4 or slot < 0:
            continue
        down, right = d // 3, d % 3
        for a in range(1 if down != 1 else side):
            for b in range(1 if right != 1 else side):
                y = side - 1 if down == 0 else (0 if down == 2 else a)
                x = side - 1 if right == 0 else (0 if right == 2 else b)
                to_y = 0 if down == 0 else (side + 1 if down == 2 else a + 1)
                to_x = 0 if right == 0 else (side + 1 if right == 2 else b + 1)
                padded[to_y, to_x] = masks[slot, y, x]
    for y in range(side + 2):
        left = np.uint64(0)
        for x in range(side + 2):
            here = padded[y, x]
            right_word = padded[y, x + 1] if x <= side else np.uint64(0)
            padded[y, x] = left | here | right_word
            left = here
    for x in range(side + 2):
        above = np.uint64(0)
        for y in range(side + 2):
            here = padded[y, x]
            below = padded[y + 1, x] if y <= side else np.uint64(0)
            padded[y, x] = above | here | below
            above = here


@njit(cache=True)
def rising_regions(masks: NDArray[np.uint64], around: NDArray[np.int32], n_steps: int) -> NDArray[np.uint64]:
    """Return the voxels whose region rises by at least `n_steps` layers."""
    side = masks.shape[1]
    one = np.uint64(1)
    padded = np.empty((side + 2, side + 2), dtype=np.uint64)
    reached = masks.copy()
    for _ in range(n_steps):
        before = reached.copy()
        for block in range(len(masks)):
            _spread(before, around, block, padded)
            for y in range(side):
                for x in range(side):
                    reached[block, y, x] = masks[block, y, x] & (padded[y + 1, x + 1] >> one)
    return reached


@njit(cache=True)
def reaching(masks: NDArray[np.uint64], around: NDArray[np.int32], layer: int) -> NDArray[np.uint64]:
    """Return the voxels whose region reaches `layer` or above, including voxels in these layers."""
    side = masks.shape[1]
    one = np.uint64(1)
    padded = np.empty((side + 2, side + 2), dtype=np.uint64)
    above = ~((one << np.uint64(layer)) - one)
    reached = masks.copy()
    flat = reached.reshape(-1)
    for at in range(len(flat)):
        flat[at] &= above
    for _ in range(layer):
        grows, before = False, reached.copy()
        for block in range(len(masks)):
            _spread(before, around, block, padded)
            for y in range(side):
                for x in range(side):
                    reached[block, y, x] |= masks[block, y, x] & (padded[y + 1, x + 1] >> one)
                    grows |= reached[block, y, x] != before[block, y, x]
        if not grows:
            break
    return reached


@njit(cache=True, nogil=True)
def label_points(
    xyz: NDArray[np.floating],
    span: Span,
    lookup: Lookup,
    volume: tuple[NDArray[np.float32], NDArray[np.uint64]],
    heights: tuple[np.float32, np.float32, np.float32],
) -> NDArray[np.bool_]:
    """Return which points of a range are ground: on the surface, or near it and outside object voxels.

    `volume` is the surface and the voxels of objects. `heights` are (lowest, base, highest): points below `lowest` are
    outliers, points below `base` are always ground, points above `highest` never.
    """
    surface, objects = volume
    lowest, base, highest = heights
    is_ground = np.zeros(span[1] - span[0], dtype=np.bool_)
    x0, y0, z0, per_metre, n_columns, _ = lookup[0]
    per_layer = np.float32(per_metre)
    slot, corner_x, corner_y = 0, NOWHERE, NOWHERE
    for i in range(span[0], span[1]):
        ix = int((np.float64(xyz[i, 0]) - x0) * per_metre)
        iy = int((np.float64(xyz[i, 1]) - y0) * per_metre)
        if not (0 <= ix - corner_x < n_columns and 0 <= iy - corner_y < n_columns):
            slot, corner_x, corner_y = find_block(ix, iy, lookup)
        y, x = iy - corner_y, ix - corner_x
        height = np.float32(np.float64(xyz[i, 2]) - z0) - surface[slot, y, x]
        if height < lowest or height > highest:
            continue
        if height < base:
            is_ground[i - span[0]] = True
        else:
            layer = np.uint64(max(height * per_layer, np.float32(0)))
            is_ground[i - span[0]] = (objects[slot, y, x] >> layer) & np.uint64(1) == 0
    return is_ground
