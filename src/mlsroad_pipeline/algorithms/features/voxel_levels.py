"""Voxels of a cloud and the coarser levels above them, sorted by column with z fastest.

A cell of the next level holds eight cells: their indices halve. The cells of a column are therefore contiguous on every
level, and sums of a level add those of the level below.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.cells import (
    bounding_box,
    first_window,
    move_window,
    run_starts,
    spread_owners,
)
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort

MARGIN = 4
"""Empty cells around the occupied ones: windows of up to three cells do not wrap into the next column."""
_MAX_CELLS = 2**62


@dataclass(frozen=True)
class Cells:
    """Occupied cells of one level."""

    keys: NDArray[np.int64]  # Ascending keys ``(ix * ny + iy) * nz + iz``
    index: NDArray[np.int32]  # ix, iy and iz, from 0, without the margin
    shape: tuple[int, int, int]  # (nx, ny, nz), including margins

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.keys)

    def rows(self, reach: int) -> NDArray[np.int64]:
        """Return (dx, dy, key offset) of the columns up to `reach` cells away, shape (r, 3), for `move_window`."""
        _, ny, nz = self.shape
        steps = range(-reach, reach + 1)
        return np.array([(dx, dy, (dx * ny + dy) * nz) for dx in steps for dy in steps], dtype=np.int64)


@dataclass(frozen=True)
class Columns:
    """Occupied columns of one level, the cells with equal ix and iy."""

    keys: NDArray[np.int64]  # Ascending keys ``ix * ny + iy``
    of_cell: NDArray[np.int32]  # Column of each cell
    ny: int  # Factor of the keys

    def rows(self, reach: int) -> NDArray[np.int64]:
        """Return (dx, 0, key offset) of the rows of columns up to `reach` away, for `move_window`."""
        return np.array([(dx, 0, dx * self.ny) for dx in range(-reach, reach + 1)], dtype=np.int64)


def find_voxels(
    xyz: NDArray[np.floating], voxel_size: float
) -> tuple[Cells, NDArray[np.int32], NDArray[np.int64], NDArray[np.float64]]:
    """Sort points into voxels."""
    box = bounding_box(xyz)
    nx, ny, nz = (int(length) + 2 + 2 * MARGIN for length in ((box[1] - box[0]) // voxel_size).tolist())
    if nx * ny * nz > _MAX_CELLS:
        raise DataError(f"an extent of {(box[1] - box[0]).tolist()} m is too large for voxels of {voxel_size} m")
    point_keys = _point_keys(xyz, box[0], voxel_size, ny, nz)
    sorted_keys, order = radix_argsort(point_keys, (nx * ny * nz).bit_length())
    starts = run_starts(sorted_keys)
    keys = sorted_keys[starts[:-1]]
    return Cells(keys, _indices(keys, ny, nz), (nx, ny, nz)), order, starts, box[0]


def halve(cells: Cells) -> tuple[Cells, NDArray[np.int32]]:
    """Return the cells of the next level."""
    nx, ny, nz = (int(n) // 2 + 1 + 2 * MARGIN for n in cells.shape)
    fine_keys = _halved_keys(cells.index, ny, nz)
    sorted_keys, order = radix_argsort(fine_keys, (nx * ny * nz).bit_length())
    starts = run_starts(sorted_keys)
    keys = sorted_keys[starts[:-1]]
    return Cells(keys, _indices(keys, ny, nz), (nx, ny, nz)), spread_owners(order, starts)


def columns_of(cells: Cells) -> Columns:
    """Return the columns of cells."""
    column_keys = cells.keys // cells.shape[2]
    starts = run_starts(column_keys)
    of_cell = spread_owners(np.arange(len(cells), dtype=np.int32), starts)
    return Columns(column_keys[starts[:-1]], of_cell, cells.shape[1])


@njit(cache=True, nogil=True)
def _point_keys(xyz: NDArray, minimum: NDArray, size: float, ny: int, nz: int) -> NDArray[np.int64]:
    keys = np.empty(len(xyz), np.int64)
    for i in range(len(xyz)):
        ix = np.int64((xyz[i, 0] - minimum[0]) / size) + MARGIN
        iy = np.int64((xyz[i, 1] - minimum[1]) / size) + MARGIN
        iz = np.int64((xyz[i, 2] - minimum[2]) / size) + MARGIN
        keys[i] = (ix * ny + iy) * nz + iz
    return keys


@njit(cache=True, nogil=True)
def _halved_keys(index: NDArray, ny: int, nz: int) -> NDArray[np.int64]:
    keys = np.empty(len(index), np.int64)
    for i in range(len(index)):
        ix, iy, iz = np.int64(index[i, 0] >> 1), np.int64(index[i, 1] >> 1), np.int64(index[i, 2] >> 1)
        keys[i] = ((ix + MARGIN) * ny + iy + MARGIN) * nz + iz + MARGIN
    return keys


@njit(cache=True, nogil=True)
def _indices(keys: NDArray, ny: int, nz: int) -> NDArray[np.int32]:
    index = np.empty((len(keys), 3), np.int32)
    for i in range(len(keys)):
        column = keys[i] // nz
        index[i, 0], index[i, 1], index[i, 2] = column // ny - MARGIN, column % ny - MARGIN, keys[i] % nz - MARGIN
    return index


@njit(cache=True, nogil=True)
def sum_by_owner(owner: NDArray, values: NDArray, n_groups: int) -> NDArray[np.float64]:
    """Return the sums (groups, m) of the rows of `values` (n, m)."""
    sums = np.zeros((n_groups, values.shape[1]))
    for i in range(len(owner)):
        for j in range(values.shape[1]):
            sums[owner[i], j] += values[i, j]
    return sums


@njit(cache=True, nogil=True)
def sum_windows(keys: NDArray, rows: NDArray, reach: int, values: NDArray, first: int, last: int, out: NDArray) -> None:
    """Write the sums of `values` (c, m) over the window of each cell from `first` to `last`."""
    if first >= last:
        return
    begin, end = first_window(keys, keys[first], rows, reach)
    for i in range(first, last):
        move_window(keys, keys[i], rows, reach, begin, end)
        out[i] = 0.0
        for j in range(len(rows)):
            for p in range(begin[j], end[j]):
                for q in range(values.shape[1]):
                    out[i, q] += values[p, q]
