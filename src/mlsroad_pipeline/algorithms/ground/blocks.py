"""Sparse XY grid of the ground filter: occupied blocks of columns.

A *column* has the width of a voxel; `n_columns` x `n_columns` columns form a *block*. Occupied blocks are numbered in
the order of their keys, so that results depend neither on the order of the points nor on the threads. A distant outlier
costs one block, not a large raster. Each pass reads the points in order and caches the block of the previous point.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.cells import EMPTY, build_table, checked_bounds, find_key, hash_key
from mlsroad_pipeline.algorithms.geometry.threads import run_ranges

Span: TypeAlias = tuple[int, int]
"""First point of a range and one past its last."""

Frame: TypeAlias = tuple[float, float, float, float, int, int]
"""Origin x, y, z, columns per metre, columns per block side, and key stride."""

Lookup: TypeAlias = tuple[Frame, NDArray[np.int64], NDArray[np.int32]]
"""Frame and rows of the blocks of a grid, for the column of a point."""

NOWHERE = -(2**60)
"""First column of the cached block before the first point, far from all columns."""

CELLS_PER_BLOCK = 1024
"""Cells of the grid per occupied block up to which rows are looked up by key: 4 KiB, a sixth of a block's columns."""

SCATTERED = 4
"""Largest mean number of consecutive points in a block of scattered points."""

RECENT_KEYS = 4096
"""Keys of blocks remembered in a first pass; a power of two."""

MAX_Z_RANGE = 1e5
"""Maximum height range, metres; float32 resolves it to a centimetre."""

MAX_BLOCKS_PER_AXIS = 2**31
"""Maximum blocks along an axis, so that block keys fit 64 bits."""


@dataclass(frozen=True)
class BlockGrid:
    """Occupied blocks of columns of a point cloud."""

    origin: NDArray[np.float64]  # Minimum coordinates of the points; kernels subtract it in float64
    width: float  # Width of a column in metres
    n_columns: int  # Columns along the side of a block
    stride: int  # Blocks along x per row of keys, including the ring around the points
    keys: NDArray[np.int64]  # Key ``(by + 2) * stride + bx + 2`` of each occupied block, ascending
    # Row of `keys` by key, -1 for empty blocks, and no keys; of a sparse grid, an open-addressing hash table, where -1
    # marks a free entry
    table_keys: NDArray[np.int64]
    table_slots: NDArray[np.int32]
    scattered: bool = False  # Whether many points lie in another block than the point before, as in random order

    @property
    def frame(self) -> Frame:
        """Origin, columns per metre, columns per block and stride."""
        x, y, z = (float(value) for value in self.origin)
        return x, y, z, 1.0 / self.width, self.n_columns, self.stride

    @property
    def lookup(self) -> Lookup:
        """Frame and rows of the blocks."""
        return self.frame, self.table_keys, self.table_slots


@njit(cache=True, nogil=True)
def find_slot(table_keys: NDArray[np.int64], table_slots: NDArray[np.int32], key: int) -> np.int32:
    """Return the row of a block by its key; -1 for empty blocks."""
    if len(table_keys) == 0:
        return table_slots[key] if 0 <= key < len(table_slots) else np.int32(-1)
    return np.int32(find_key(table_keys, table_slots, key))


def build_lookup(keys: NDArray[np.int64], n_cells: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return the arrays that `find_slot` reads: rows by key and no keys, or a hash table where most cells are empty.

    Points in random order need the row of another block each.
    """
    if n_cells > CELLS_PER_BLOCK * len(keys):
        return build_table(keys)
    slots = np.full(n_cells, -1, dtype=np.int32)
    slots[keys] = np.arange(len(keys))
    return np.empty(0, dtype=np.int64), slots


@njit(cache=True, nogil=True, inline="always")
def block_of(column: int, n_columns: int) -> int:
    """Return the block of a column; a product of float64 is exact here, and faster than a division of integers."""
    return int(np.floor((column + 0.5) * (1.0 / n_columns)))


@njit(cache=True, nogil=True)
def find_block(ix: int, iy: int, lookup: Lookup) -> tuple[int, int, int]:
    """Return the row of the block of a column, and its first column along x and y.

    Kernels call it only if a point is outside the block of the previous point, which saves divisions and lookups.
    """
    (_, _, _, _, n_columns, stride), table_keys, table_slots = lookup
    bx, by = block_of(ix, n_columns), block_of(iy, n_columns)
    slot = find_slot(table_keys, table_slots, (by + 2) * stride + bx + 2)
    return int(slot), bx * n_columns, by * n_columns


@njit(cache=True, nogil=True)
def _insert(table: NDArray[np.int64], key: int) -> bool:
    """Insert a key into an open-addressing set; return whether it is new."""
    mask = len(table) - 1
    at = hash_key(key, mask)
    while table[at] != EMPTY and table[at] != key:
        at = (at + 1) & mask
    is_new = table[at] == EMPTY
    table[at] = key
    return is_new


@njit(cache=True, nogil=True)
def _keys_of_range(xyz: NDArray[np.floating], span: Span, frame: Frame) -> tuple[NDArray[np.int64], int]:
    """Return the distinct block keys of a range of points, unsorted, and the number of points in another block."""
    x0, y0, _, per_metre, n_columns, stride = frame
    table = np.full(1024, EMPTY, dtype=np.int64)
    recent = np.full(RECENT_KEYS, -1, dtype=np.int64)  # in the order of their remainders
    used, changes = 0, 0
    corner_x, corner_y = NOWHERE, NOWHERE
    for i in range(span[0], span[1]):
        ix = int((np.float64(xyz[i, 0]) - x0) * per_metre)
        iy = int((np.float64(xyz[i, 1]) - y0) * per_metre)
        if 0 <= ix - corner_x < n_columns and 0 <= iy - corner_y < n_columns:
            continue
        changes += 1
        bx, by = block_of(ix, n_columns), block_of(iy, n_columns)
        corner_x, corner_y = bx * n_columns, by * n_columns
        key = (by + 2) * stride + bx + 2
        if recent[key % RECENT_KEYS] == key:
            continue
        recent[key % RECENT_KEYS] = key
        used += _insert(table, key)
        if 2 * used > len(table):
            smaller = table
            table = np.full(2 * len(smaller), EMPTY, dtype=np.int64)
            for key in smaller[smaller != EMPTY]:
                _insert(table, key)
    return table[table != EMPTY], changes


def bounds_of(
    xyz: ArrayLike, n_threads: int = 1
) -> tuple[NDArray[np.floating], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Validate coordinates and return them with their bounds."""
    points, low, high = checked_bounds(xyz, n_threads=n_threads)
    if len(points) and high[2] - low[2] > MAX_Z_RANGE:
        raise DataError(f"xyz spans {high[2] - low[2]:g} m in z, more than {MAX_Z_RANGE:g}: remove outliers")
    return points, (low, high)


def build_blocks(
    xyz: NDArray[np.floating],
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
    *,
    width: float,
    n_columns: int,
    n_threads: int = 1,
) -> BlockGrid:
    """Return the occupied blocks of a point cloud."""
    low, high = bounds
    n_blocks = np.floor((high - low)[:2] / width / n_columns) + 5
    if n_blocks.max() >= MAX_BLOCKS_PER_AXIS:
        raise DataError(
            f"xyz spans {(high - low)[:2].tolist()} m, too large for blocks of {width * n_columns} m: remove outliers"
        )
    grid = BlockGrid(
        origin=low,
        width=width,
        n_columns=n_columns,
        stride=int(n_blocks[0]),
        keys=np.empty(0, dtype=np.int64),
        table_keys=np.empty(0, dtype=np.int64),
        table_slots=np.empty(0, dtype=np.int32),
    )
    parts = run_ranges(lambda *span: _keys_of_range(xyz, span, grid.frame), len(xyz), n_threads)
    keys = np.unique(np.concatenate([part[0] for part in parts]))
    scattered = SCATTERED * sum(part[1] for part in parts) > len(xyz)
    table_keys, table_slots = build_lookup(keys, int(n_blocks[0] * n_blocks[1]))
    return BlockGrid(low, width, n_columns, grid.stride, keys, table_keys, table_slots, scattered)


@njit(cache=True)
def neighbour_slots(
    keys: NDArray[np.int64], table_keys: NDArray[np.int64], table_slots: NDArray[np.int32], stride: int
) -> NDArray[np.int32]:
    """Return the rows of the 3 x 3 neighbourhood of each block, (b, 9) int32 in rows of y; -1 for empty blocks."""
    slots = np.empty((len(keys), 9), dtype=np.int32)
    for row in range(len(keys)):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                slots[row, 3 * (dy + 1) + dx + 1] = find_slot(table_keys, table_slots, keys[row] + dy * stride + dx)
    return slots


@njit(cache=True, nogil=True)
def column_minima(xyz: NDArray[np.floating], span: Span, lookup: Lookup, minima: NDArray[np.float32]) -> None:
    """Update `minima` (b, columns, columns) with the lowest z of each column, metres above the origin of the grid."""
    x0, y0, z0, per_metre, n_columns, _ = lookup[0]
    slot, corner_x, corner_y = 0, NOWHERE, NOWHERE
    for i in range(span[0], span[1]):
        ix = int((np.float64(xyz[i, 0]) - x0) * per_metre)
        iy = int((np.float64(xyz[i, 1]) - y0) * per_metre)
        if not (0 <= ix - corner_x < n_columns and 0 <= iy - corner_y < n_columns):
            slot, corner_x, corner_y = find_block(ix, iy, lookup)
        y, x = iy - corner_y, ix - corner_x
        minima[slot, y, x] = min(minima[slot, y, x], np.float32(np.float64(xyz[i, 2]) - z0))


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
    run_ranges(lambda *span: _sort_range(xyz, span, grid.lookup, n_blocks, ordered, order), len(xyz), n_threads)
    return ordered, order


@njit(cache=True, nogil=True)
def in_rows(values: NDArray[np.bool_], order: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the values of sorted points in the order of the input."""
    restored = np.empty_like(values)
    for i in range(len(order)):
        restored[order[i]] = values[i]
    return restored
