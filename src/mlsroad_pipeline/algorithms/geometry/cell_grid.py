"""Cell grid for neighbourhood kernels, and their distribution over threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort

_MAX_CELLS = 2**62
CELLS_PER_RADIUS = 2
"""Cells per search radius: smaller cells need fewer distance tests, larger cells share more candidate lists."""


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

    def centres(self) -> NDArray[np.float64]:
        """Return the centres of the occupied cells, metres, shape (c, 3)."""
        nx, ny, _ = self.shape
        indices = np.stack([self.keys % nx, self.keys // nx % ny, self.keys // (nx * ny)], axis=1)
        return self.minimum + (indices - self.margin + 0.5) * self.cell_size

    def row_offsets(self, reach: int) -> NDArray[np.int64]:
        """Return (dy, dz, key offset) of the rows of cells up to `reach` cells away, shape (r, 3)."""
        nx, ny, _ = self.shape
        steps = range(-reach, reach + 1)
        return np.array([(dy, dz, (dz * ny + dy) * nx) for dz in steps for dy in steps], dtype=np.int64)


@njit(cache=True, nogil=True)
def bounding_box(xyz: NDArray) -> NDArray[np.float64]:
    """Return minimum and maximum coordinates, float64 (2, 3); many times faster than NumPy along axis 0."""
    box = np.empty((2, 3), np.float64)
    box[0], box[1] = np.inf, -np.inf
    for i in range(len(xyz)):
        for axis in range(3):
            value = np.float64(xyz[i, axis])
            box[0, axis] = min(box[0, axis], value)
            box[1, axis] = max(box[1, axis], value)
    return box


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
def _occupied(sorted_keys: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    n = len(sorted_keys)
    n_cells = 0
    for i in range(n):
        if i == 0 or sorted_keys[i] != sorted_keys[i - 1]:
            n_cells += 1
    keys = np.empty(n_cells, np.int64)
    starts = np.empty(n_cells + 1, np.int64)
    cell = 0
    for i in range(n):
        if i == 0 or sorted_keys[i] != sorted_keys[i - 1]:
            keys[cell] = sorted_keys[i]
            starts[cell] = i
            cell += 1
    starts[n_cells] = n
    return keys, starts


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
        keys, starts = _occupied(sorted_keys)
        local = _local_coordinates(array, order, keys, starts, minimum, cell_size, nx, ny, margin)
        grids.append(CellGrid(order, keys, starts, local, (nx, ny, nz), cell_size, minimum, margin))
    return grids


def check_threads(n_threads: int) -> int:
    """Check a number of threads and return it."""
    if not isinstance(n_threads, int | np.integer):
        raise ParameterError(f"n_threads must be an integer, got {n_threads!r}")
    check_at_least(n_threads, 1, "n_threads")
    return int(n_threads)


def run_in_chunks(kernel: Callable[..., Any], n_items: int, *, n_threads: int) -> list[Any]:
    """Call ``kernel(start, stop)`` on contiguous chunks of items, in a thread pool."""
    check_threads(n_threads)
    if n_threads == 1 or n_items < 2:
        return [kernel(0, n_items)]
    # More chunks than threads balance the load between dense and sparse parts of the cloud.
    bounds = np.linspace(0, n_items, 1 + min(n_items, 8 * n_threads)).astype(np.int64).tolist()
    with ThreadPoolExecutor(n_threads) as pool:
        return list(pool.map(kernel, bounds[:-1], bounds[1:]))
