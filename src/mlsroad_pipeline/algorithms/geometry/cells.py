"""Cells of a cloud: keys, their sort, runs of equal keys, windows of neighbours, and hash tables of keys.

A key is one integer of 64 bits. Points sorted by key lie in runs, one per occupied cell, in their order within a run.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.sorting import lower_bound, radix_argsort
from mlsroad_pipeline.algorithms.geometry.threads import run_ranges

_MAX_CELLS = 2**62
_KEY_BITS = 62
CELLS_PER_RADIUS = 2
"""Cells per search radius: smaller cells need fewer distance tests, larger cells share more candidate lists."""
EMPTY = -1
"""Key of a free slot of a hash table."""


@njit(cache=True, nogil=True)
def bounding_box(xyz: NDArray) -> NDArray[np.float64]:
    """Return minimum and maximum coordinates, float64 (2, 3); many times faster than NumPy along axis 0."""
    box = np.empty((2, 3), np.float64)
    for axis in range(3):
        box[0, axis], box[1, axis] = np.inf, -np.inf
    for i in range(len(xyz)):
        for axis in range(3):
            value = np.float64(xyz[i, axis])
            box[0, axis] = min(box[0, axis], value)
            box[1, axis] = max(box[1, axis], value)
    return box


@njit(cache=True, nogil=True)
def _bounds(xyz: NDArray[np.floating], start: int, stop: int) -> NDArray[np.float64]:
    """Return the minimum and maximum of each axis; the last value is NaN if a coordinate is not finite."""
    low_x = low_y = low_z = np.inf
    high_x = high_y = high_z = -np.inf
    zero = 0.0  # stays 0 for finite coordinates and becomes NaN otherwise
    for i in range(start, stop):
        x, y, z = np.float64(xyz[i, 0]), np.float64(xyz[i, 1]), np.float64(xyz[i, 2])
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
        low_z, high_z = min(low_z, z), max(high_z, z)
        zero += (x - x) + (y - y) + (z - z)
    return np.array([low_x, low_y, low_z, high_x, high_y, high_z, zero])


def checked_bounds(
    xyz: ArrayLike, *, n_threads: int = 1, minimum: int = 0
) -> tuple[NDArray[np.floating], NDArray[np.float64], NDArray[np.float64]]:
    """Return contiguous finite points with their minimum and maximum corners, in one pass."""
    points = np.asarray(xyz)
    usable = points.dtype in (np.float32, np.float64) and points.ndim == 2 and points.shape[1] == 3
    points = np.ascontiguousarray(points) if usable and len(points) >= minimum else check_xyz(xyz, minimum=minimum)
    parts = np.array(run_ranges(lambda start, stop: _bounds(points, start, stop), len(points), n_threads))
    if np.isnan(parts[:, 6]).any():
        check_xyz(points)  # raises an error with the row
    return points, parts[:, :3].min(axis=0), parts[:, 3:6].max(axis=0)


@njit(cache=True, nogil=True)
def run_starts(sorted_keys: NDArray) -> NDArray[np.int64]:
    """Return the first row of each distinct key, and the number of rows."""
    n, n_distinct = len(sorted_keys), 0
    for i in range(n):
        n_distinct += i == 0 or sorted_keys[i] != sorted_keys[i - 1]
    starts = np.empty(n_distinct + 1, np.int64)
    at = 0
    for i in range(n):
        if i == 0 or sorted_keys[i] != sorted_keys[i - 1]:
            starts[at] = i
            at += 1
    starts[at] = n
    return starts


@njit(cache=True, nogil=True)
def spread_owners(order: NDArray, starts: NDArray) -> NDArray[np.int32]:
    """Return the group of each item, where group j holds ``order[starts[j]:starts[j + 1]]``."""
    owner = np.empty(len(order), np.int32)
    for group in range(len(starts) - 1):
        for i in range(starts[group], starts[group + 1]):
            owner[order[i]] = group
    return owner


@dataclass(frozen=True)
class SortedCells:
    """Points sorted into the occupied cells of a grid through the world's zero, by x, then y, then z."""

    order: NDArray[np.int32]  # Point indices in the order of their cells, ascending within a cell
    starts: NDArray[np.int64]  # Cell j holds ``order[starts[j]:starts[j + 1]]``
    index: NDArray[np.int64]  # Cell indices along x, y and z
    packed: bool  # Whether indices fit one key; the sort of others takes longer

    def owner(self) -> NDArray[np.int64]:
        """Return the cell of each point."""
        return spread_owners(self.order, self.starts).astype(np.int64)


def sort_into_cells(xyz: NDArray[np.floating], *, origin: NDArray[np.float64], size: float) -> SortedCells:
    """Sort points into the cells ``floor((xyz + origin) / size)``."""
    if not len(xyz):
        return SortedCells(np.zeros(0, np.int32), np.zeros(1, np.int64), np.zeros((0, 3), np.int64), True)
    low, high = np.floor((bounding_box(xyz) + origin) / size).astype(np.int64)
    bits = np.array([int(n).bit_length() for n in high - low])
    if bits.sum() > _KEY_BITS:
        index = np.floor((xyz + origin) / size).astype(np.int64)
        order = order_of_cells(index).astype(np.int32)
        new = (np.diff(index[order], axis=0) != 0).any(axis=1)
        starts = np.concatenate([[0], np.flatnonzero(new) + 1, [len(xyz)]])
    else:
        sorted_keys, order = radix_argsort(_packed_keys(xyz, origin, size, low, bits), int(bits.sum()))
        starts = run_starts(sorted_keys)
    index = np.floor((xyz[order[starts[:-1]]] + origin) / size).astype(np.int64)
    return SortedCells(order, starts, index, bits.sum() <= _KEY_BITS)


@njit(cache=True, nogil=True)
def _packed_keys(
    xyz: NDArray, origin: NDArray, size: float, low: NDArray[np.int64], bits: NDArray[np.int64]
) -> NDArray[np.int64]:
    keys = np.empty(len(xyz), np.int64)
    for i in range(len(xyz)):
        key = 0
        for axis in range(3):
            key = (key << bits[axis]) | (int(np.floor((xyz[i, axis] + origin[axis]) / size)) - low[axis])
        keys[i] = key
    return keys


def order_of_cells(index: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the order of cells by x, then y, then z."""
    low, high = ([int(ends(index[:, axis])) for axis in range(3)] for ends in (np.min, np.max))
    bits = [(last - first).bit_length() for first, last in zip(low, high, strict=True)]
    if sum(bits) > _KEY_BITS:  # extent exceeds a packed key: slower, same order
        return np.lexsort((index[:, 2], index[:, 1], index[:, 0]))
    packed = np.zeros(len(index), np.int64)
    for axis, shift in enumerate((bits[1] + bits[2], bits[2], 0)):
        packed |= (index[:, axis].astype(np.int64) - low[axis]) << shift
    return radix_argsort(packed, sum(bits))[1]


@dataclass(frozen=True)
class CellGrid:
    """Points sorted into the occupied cells of a grid with x fastest, so that the cells of a row are contiguous."""

    order: NDArray[np.int32]  # Point indices in the order of their cells, ascending within a cell
    keys: NDArray[np.int64]  # Ascending keys ``(iz * ny + iy) * nx + ix`` of the occupied cells
    starts: NDArray[np.int64]  # Cell j holds ``order[starts[j]:starts[j + 1]]``
    # Coordinates in `order`, relative to the centre of the point's cell, metres. float32 resolves these to nanometres
    # for any origin.
    local: NDArray[np.float32]
    shape: tuple[int, int, int]  # (nx, ny, nz), including margins
    cell_size: float  # Edge of a cell in metres
    minimum: NDArray[np.float64]  # Minimum corner of the cells inside the margin, metres
    margin: int  # Empty cells below and above the points along each axis

    def row_offsets(self, reach: int) -> NDArray[np.int64]:
        """Return (dy, dz, key offset) of the rows of cells up to `reach` cells away, shape (r, 3)."""
        nx, ny, _ = self.shape
        steps = range(-reach, reach + 1)
        return np.array([(dy, dz, (dz * ny + dy) * nx) for dz in steps for dy in steps], dtype=np.int64)


@njit(cache=True, nogil=True)
def cell_keys(xyz: NDArray, minimum: NDArray, inverse: float, nx: int, ny: int, margin: int) -> NDArray[np.int64]:
    """Return the key of each point for cells of edge ``1 / inverse``.

    The margin prevents neighbours of border cells from wrapping into the next row.
    """
    keys = np.empty(len(xyz), np.int64)
    for i in range(len(xyz)):
        ix = np.int64((xyz[i, 0] - minimum[0]) * inverse) + margin
        iy = np.int64((xyz[i, 1] - minimum[1]) * inverse) + margin
        iz = np.int64((xyz[i, 2] - minimum[2]) * inverse) + margin
        keys[i] = (iz * ny + iy) * nx + ix
    return keys


@njit(cache=True, nogil=True)
def _local_coordinates(
    xyz: NDArray,
    order: NDArray,
    keys: NDArray,
    starts: NDArray,
    minimum: NDArray,
    cell_size: float,
    nx: int,
    ny: int,
    margin: int,
) -> NDArray[np.float32]:
    local = np.empty((3, len(order)), np.float32)
    for cell in range(len(keys)):
        key = keys[cell]
        centre_x = minimum[0] + (key % nx - margin + 0.5) * cell_size
        centre_y = minimum[1] + (key // nx % ny - margin + 0.5) * cell_size
        centre_z = minimum[2] + (key // (nx * ny) - margin + 0.5) * cell_size
        for i in range(starts[cell], starts[cell + 1]):
            point = order[i]
            local[0, i] = xyz[point, 0] - centre_x
            local[1, i] = xyz[point, 1] - centre_y
            local[2, i] = xyz[point, 2] - centre_z
    return local


def build_cell_grids(*clouds: ArrayLike, cell_size: float, margin: int = 1) -> list[CellGrid]:
    """Sort clouds into the cells of a common grid, anchored at their minimum corner."""
    check_positive(cell_size, "cell_size")
    arrays = [check_xyz(cloud) for cloud in clouds]
    boxes = [bounding_box(array) for array in arrays if len(array)]
    if not boxes:
        raise DataError("a cell grid needs at least one point, got none")
    minimum = np.min([box[0] for box in boxes], axis=0)
    extent = np.max([box[1] for box in boxes], axis=0) - minimum
    nx, ny, nz = (int(length // cell_size) + 2 * margin + 2 for length in extent.tolist())
    if nx * ny * nz > _MAX_CELLS:
        raise DataError(f"an extent of {extent.tolist()} m is too large for cells of {cell_size} m: remove outliers")
    n_bits = (nx * ny * nz).bit_length()
    grids = []
    for array in arrays:
        point_keys = cell_keys(array, minimum, 1.0 / cell_size, nx, ny, margin)
        sorted_keys, order = radix_argsort(point_keys, n_bits)
        starts = run_starts(sorted_keys)
        keys = sorted_keys[starts[:-1]]
        local = _local_coordinates(array, order, keys, starts, minimum, cell_size, nx, ny, margin)
        grids.append(CellGrid(order, keys, starts, local, (nx, ny, nz), cell_size, minimum, margin))
    return grids


@njit(cache=True, nogil=True)
def first_window(keys: NDArray, key: int, rows: NDArray, reach: int) -> tuple[NDArray, NDArray]:
    """Return empty ranges of cells, one per row, at the lower limit of the reach; `move_window` extends them."""
    begin, end = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
    for j in range(len(rows)):
        begin[j] = lower_bound(keys, key + rows[j, 2] - reach)
        end[j] = begin[j]
    return begin, end


@njit(cache=True, nogil=True)
def move_window(keys: NDArray, key: int, rows: NDArray, reach: int, begin: NDArray, end: NDArray) -> None:
    """Advance the range of cells of each row to those within reach of a cell; calls must be in ascending order."""
    n = len(keys)
    for j in range(len(rows)):
        low = key + rows[j, 2] - reach
        b, e = begin[j], end[j]
        while b < n and keys[b] < low:
            b += 1
        e = max(e, b)
        while e < n and keys[e] <= low + 2 * reach:
            e += 1
        begin[j], end[j] = b, e


@njit(cache=True, nogil=True)
def most_near(starts: NDArray, begin: NDArray, end: NDArray) -> int:
    """Return an upper bound, at least 1, of the number of points in the ranges of cells."""
    bound = 1
    for j in range(len(begin)):
        bound += starts[end[j]] - starts[begin[j]]
    return bound


@njit(cache=True, nogil=True)
def gather_cells(
    key: int,
    nx: int,
    reach: int,
    keys: NDArray[np.int64],
    starts: NDArray[np.int64],
    order: NDArray[np.int32],
    found: NDArray,
) -> int:
    """Write the cells in blocks at most `reach` rows and columns from a block into `found`; return their number.

    `nx` is the number of blocks in a row of the grid. `keys`, `starts` and `order` are those of `CellGrid`.
    """
    count = 0
    for dy in range(-reach, reach + 1):
        first = lower_bound(keys, key + dy * nx - reach)
        last = lower_bound(keys, key + dy * nx + reach + 1)
        for i in range(starts[first], min(starts[last], starts[first] + len(found) - count)):
            found[count] = order[i]
            count += 1
    return count


@njit(cache=True, nogil=True)
def hash_key(key: int, mask: int) -> np.int64:
    """Return the slot of a key in a table of `mask` + 1 slots (Fibonacci hashing of the high half)."""
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return np.int64((mixed >> np.uint64(32)) & np.uint64(mask))


@njit(cache=True, nogil=True)
def build_table(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Build an open-addressing table from distinct keys to their positions, at most half full."""
    size = 16
    while size < 2 * len(keys):
        size *= 2
    slots = np.full(size, EMPTY, np.int64)
    values = np.empty(size, np.int32)
    for i in range(len(keys)):
        h = hash_key(keys[i], size - 1)
        while slots[h] != EMPTY:
            h = (h + 1) & (size - 1)
        slots[h] = keys[i]
        values[h] = i
    return slots, values


@njit(cache=True, nogil=True)
def find_key(slots: NDArray[np.int64], values: NDArray[np.int32], key: int) -> int:
    """Return the position stored for a key, or -1."""
    mask = len(slots) - 1
    h = hash_key(key, mask)
    while slots[h] != EMPTY:
        if slots[h] == key:
            return values[h]
        h = (h + 1) & mask
    return -1
