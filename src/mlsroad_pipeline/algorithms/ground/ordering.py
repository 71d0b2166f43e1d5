"""Points in random order, sorted by block so that each pass stays in the columns of one block for a while."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.ground.blocks import BlockGrid, Lookup, block_of, find_slot
from mlsroad_pipeline.algorithms.ground.spans import Span, in_chunks

_CHUNK = 1 << 16
"""Points sorted at a time: they and their labels fit the cache."""


@njit(cache=True, nogil=True)
def _sort_range(
    xyz: NDArray[np.floating],
    span: Span,
    lookup: Lookup,
    n_blocks: int,
    ordered: NDArray[np.floating],
    order: NDArray[np.int32],
) -> None:
    """Sort each chunk of a range by block, stably."""
    (x0, y0, _, per_metre, n_columns, stride), table_keys, table_slots = lookup
    slots = np.empty(_CHUNK, np.int32)
    starts = np.empty(n_blocks + 1, np.int64)
    for first in range(span[0], span[1], _CHUNK):
        last = min(span[1], first + _CHUNK)
        starts[:] = 0
        for i in range(first, last):
            bx = block_of(int((np.float64(xyz[i, 0]) - x0) * per_metre), n_columns)
            by = block_of(int((np.float64(xyz[i, 1]) - y0) * per_metre), n_columns)
            slot = find_slot(table_keys, table_slots, (by + 2) * stride + bx + 2)
            slots[i - first] = slot
            starts[slot + 1] += 1
        for block in range(n_blocks):
            starts[block + 1] += starts[block]
        for i in range(first, last):
            at = first + starts[slots[i - first]]
            starts[slots[i - first]] += 1
            for axis in range(3):
                ordered[at, axis] = xyz[i, axis]
            order[at] = i


def sort_by_block(
    xyz: NDArray[np.floating], grid: BlockGrid, n_threads: int
) -> tuple[NDArray[np.floating], NDArray[np.int32]]:
    """Sort points by block, chunk by chunk."""
    ordered, order = np.empty_like(xyz), np.empty(len(xyz), dtype=np.int32)
    n_blocks = len(grid.keys)
    in_chunks(len(xyz), n_threads, lambda span: _sort_range(xyz, span, grid.lookup, n_blocks, ordered, order))
    return ordered, order


@njit(cache=True, nogil=True)
def in_rows(values: NDArray[np.bool_], order: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the values of sorted points in the order of the input."""
    restored = np.empty_like(values)
    for i in range(len(order)):
        restored[order[i]] = values[i]
    return restored
