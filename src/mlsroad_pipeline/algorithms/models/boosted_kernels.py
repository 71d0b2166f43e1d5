"""Kernels of boosted trees, see `boosted_trees`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ROWS = 128
"""Rows of a block: masks and codes of a block stay in the cache."""
_RIGHT = 255
"""Code of NaN that goes right; 0 is that of NaN that goes left."""
_DE_BRUIJN = {4: 0x077CB531, 8: 0x03F79D71B4CB0A89}
"""Bytes of a word to the sequence that, times an isolated bit, gives its position in the highest bits."""


def leaf_slots(word: np.dtype[Any]) -> tuple[NDArray[np.intp], Any, Any]:
    """Return the slot of each leaf in a table of leaf values, and factor and shift that give it from the leaf's bit."""
    n_bits = 8 * word.itemsize
    factor, shift = word.type(_DE_BRUIJN[word.itemsize]), word.type(n_bits - n_bits.bit_length() + 1)
    bits = word.type(1) << np.arange(n_bits, dtype=word)
    return (bits * factor >> shift).astype(np.intp), factor, shift


@njit(cache=True, nogil=True)
def _encode(table: NDArray, thresholds: NDArray, starts: NDArray, first: int, last: int, codes: NDArray) -> None:
    """Write the number of thresholds below each feature, twice: NaN goes left in even rows of `codes`, right in odd."""
    n = last - first
    at, values = np.zeros(_ROWS, np.int32), np.zeros(_ROWS, np.float32)
    for f in range(table.shape[1]):
        own = thresholds[starts[f] : starts[f + 1]]
        for i in range(n):
            values[i] = table[first + i, f]
        at[:] = 0
        size = len(own)
        while size > 0:  # binary search of all rows at the same time
            half = (size + 1) >> 1
            for i in range(_ROWS):
                at[i] += np.int32(half) if own[at[i] + half - 1] < values[i] else np.int32(0)
            size -= half
        for i in range(n):
            missing = np.isnan(values[i])
            codes[2 * f, i] = 0 if missing else at[i]
            codes[2 * f + 1, i] = _RIGHT if missing else at[i]


@njit(cache=True, nogil=True)
def add_trees(
    table: NDArray,
    thresholds: NDArray,
    threshold_starts: NDArray,
    node_starts: NDArray,
    columns: NDArray,
    node_codes: NDArray,
    masks: NDArray,
    leaves: NDArray,
    factor: np.unsignedinteger,
    shift: np.unsignedinteger,
    tree_class: NDArray,
    initial: NDArray,
    out: NDArray,
    first: int,
    last: int,
) -> None:
    """Add the leaf values of all trees, block by block; the type of `masks` is that of a word of one bit per leaf."""
    word = masks.dtype.type
    codes = np.zeros((2 * table.shape[1], _ROWS), np.uint8)
    alive, sums = np.empty(_ROWS, masks.dtype), np.empty((len(initial), _ROWS))
    nothing, one = word(0), word(1)
    everything = word(~nothing)
    for block in range(first, last, _ROWS):
        n_block = min(_ROWS, last - block)
        _encode(table, thresholds, threshold_starts, block, block + n_block, codes)
        for c in range(len(initial)):
            sums[c] = initial[c]
        for tree in range(len(tree_class)):
            alive[:] = everything
            for node in range(node_starts[tree], node_starts[tree + 1]):
                row, code, mask = codes[columns[node]], node_codes[node], masks[node]
                for r in range(_ROWS):
                    alive[r] &= mask | (nothing if row[r] > code else everything)
            total, values = sums[tree_class[tree]], leaves[tree]
            for r in range(_ROWS):
                lowest = word(alive[r] & word(~alive[r] + one))
                total[r] += values[word(lowest * factor) >> shift]
        for r in range(n_block):
            for c in range(len(initial)):
                out[block + r, c] = sums[c, r]
