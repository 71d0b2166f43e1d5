"""Kernels of boosted trees, see `boosted_trees`."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ROWS = 512
"""Rows of a block: masks and codes of a block stay in the cache."""
_RIGHT = 255
"""Code of NaN that goes right; 0 is that of NaN that goes left."""
_FACTOR, _SHIFT = np.uint32(0x077CB531), np.uint32(27)
"""De Bruijn sequence of 32 bits: times an isolated bit, its five highest bits differ for each bit."""
_HALF = 32
"""Leaves of half a tree."""


LEAF_SLOTS = np.add.outer((0, _HALF), (np.uint32(1) << np.arange(_HALF, dtype=np.uint32)) * _FACTOR >> _SHIFT).ravel()
"""Place of each leaf, from left to right, in the table of leaf values of a tree."""


@njit(cache=True, nogil=True)
def order_leaves(left: NDArray, right: NDArray, starts: NDArray, masks: NDArray, ordered: NDArray) -> None:
    """Write the bits of the leaves of each node's left subtree, and the leaves of each tree from left to right."""
    path, first = np.empty(2 * _HALF, np.int64), np.empty(2 * _HALF, np.uint64)
    one = np.uint64(1)
    for tree in range(len(starts) - 1):
        node = starts[tree]
        child, depth, n = 0 if starts[tree + 1] > node else -1, 0, np.uint64(0)
        while True:
            while child >= 0:
                path[depth], first[depth] = child, n
                depth += 1
                child = left[node + child]
            ordered[node + tree + np.int64(n)] = -1 - child  # a tree has one leaf more than nodes
            n += one
            if depth == 0:
                break
            depth -= 1
            masks[node + path[depth]] = (one << n) - (one << first[depth])
            child = right[node + path[depth]]


@njit(cache=True, nogil=True)
def _encode(
    table: NDArray[np.float32],
    thresholds: NDArray[np.float32],
    starts: NDArray[np.int64],
    first: int,
    n: int,
    codes: NDArray[np.uint8],
) -> None:
    """Write the number of thresholds below each feature, twice: NaN goes left in even rows of `codes`, right in odd."""
    at, values = np.zeros(_ROWS, np.uint32), np.zeros(_ROWS, np.float32)
    for f in range(table.shape[1]):
        own = thresholds[starts[f] : starts[f + 1]]
        for i in range(n):
            values[i] = table[first + i, f]
        at[:] = 0
        size = len(own)
        while size > 0:  # binary search of all rows at the same time; unsigned indices need no check for negative ones
            half = (size + 1) >> 1
            step, before = np.uint32(half), np.uint32(half - 1)
            for i in range(_ROWS):
                at[i] += step if own[np.uint32(at[i] + before)] < values[i] else np.uint32(0)
            size -= half
        for i in range(n):
            missing = np.isnan(values[i])
            codes[2 * f, i] = 0 if missing else at[i]
            codes[2 * f + 1, i] = _RIGHT if missing else at[i]


@njit(cache=True, nogil=True)
def _first_leaves(alive: NDArray[np.uint8], words: NDArray[np.uint32], places: NDArray[np.uint8], half: int) -> None:
    """Write the place of the first leaf that is left in one half of a tree; rows without one keep their place."""
    lowest, low, high, highest = alive[4 * half], alive[4 * half + 1], alive[4 * half + 2], alive[4 * half + 3]
    offset = np.uint8(_HALF * half)
    for r in range(_ROWS):
        words[r] = (
            np.uint32(lowest[r])
            | np.uint32(low[r]) << np.uint32(8)
            | np.uint32(high[r]) << np.uint32(16)
            | np.uint32(highest[r]) << np.uint32(24)
        )
    for r in range(_ROWS):
        word = words[r]
        bit = np.uint32(word & np.uint32(~word + np.uint32(1)))
        place = np.uint8(np.uint32(bit * _FACTOR) >> _SHIFT) + offset
        places[r] = place if word != 0 else places[r]


@njit(cache=True, nogil=True)
def add_trees(
    table: NDArray[np.float32],
    thresholds: NDArray[np.float32],
    threshold_starts: NDArray[np.int64],
    part_starts: NDArray[np.int64],
    columns: NDArray[np.int16],
    part_codes: NDArray[np.uint8],
    octets: NDArray[np.uint8],
    masks: NDArray[np.uint8],
    leaves: NDArray[np.float32],
    tree_class: NDArray[np.uint8],
    initial: NDArray[np.float64],
    out: NDArray[np.float64],
    first: int,
    last: int,
) -> None:
    """Add the leaf values of all trees, block by block.

    A part of a node is one octet of eight leaves of which its left subtree has some: most nodes have one part.
    """
    codes = np.zeros((2 * table.shape[1], _ROWS), np.uint8)
    n_halves = leaves.shape[1] // _HALF
    alive, words, places = (
        np.empty((4 * n_halves, _ROWS), np.uint8),
        np.empty(_ROWS, np.uint32),
        np.empty(_ROWS, np.uint8),
    )
    sums = np.empty((len(initial), _ROWS))
    nothing, everything = np.uint8(0), np.uint8(255)
    for block in range(first, last, _ROWS):
        n_block = min(_ROWS, last - block)
        _encode(table, thresholds, threshold_starts, block, n_block, codes)
        for c in range(len(initial)):
            sums[c] = initial[c]
        for tree in range(len(tree_class)):
            alive[:] = everything
            for part in range(part_starts[tree], part_starts[tree + 1]):
                row, code, mask, octet = codes[columns[part]], part_codes[part], masks[part], alive[octets[part]]
                for r in range(_ROWS):
                    octet[r] &= mask | (nothing if row[r] > code else everything)
            for half in range(n_halves - 1, -1, -1):
                _first_leaves(alive, words, places, half)
            total, values = sums[tree_class[tree]], leaves[tree]
            for r in range(_ROWS):
                total[r] += values[places[r]]
        for r in range(n_block):
            for c in range(len(initial)):
                out[block + r, c] = sums[c, r]
