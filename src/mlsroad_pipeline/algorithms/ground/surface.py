"""Ground surface as a raster of cells, heights above it, and the kernels of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column, check_positive
from mlsroad_pipeline.algorithms.geometry.threads import run_ranges
from mlsroad_pipeline.algorithms.ground.blocks import (
    NOWHERE,
    BlockGrid,
    Lookup,
    Span,
    bounds_of,
    build_blocks,
    find_block,
)

UNITS_PER_METRE = 100_000
"""Heights are summed as integers of 0.01 mm; integer sums do not depend on the order of the points."""


@njit(cache=True, nogil=True)
def ground_minima(
    xyz: NDArray[np.floating],
    ground: NDArray[np.bool_],
    span: Span,
    lookup: Lookup,
    minima: NDArray[np.float32],
) -> None:
    """Update `minima` with the lowest ground point of each cell, metres above the origin of the grid."""
    x0, y0, z0, per_metre, n_columns, _ = lookup[0]
    slot, corner_x, corner_y = 0, NOWHERE, NOWHERE
    for i in range(span[0], span[1]):
        if not ground[i]:
            continue
        ix = int((np.float64(xyz[i, 0]) - x0) * per_metre)
        iy = int((np.float64(xyz[i, 1]) - y0) * per_metre)
        if not (0 <= ix - corner_x < n_columns and 0 <= iy - corner_y < n_columns):
            slot, corner_x, corner_y = find_block(ix, iy, lookup)
        y, x = iy - corner_y, ix - corner_x
        minima[slot, y, x] = min(minima[slot, y, x], np.float32(np.float64(xyz[i, 2]) - z0))


@njit(cache=True, nogil=True)
def ground_sums(
    xyz: NDArray[np.floating],
    ground: NDArray[np.bool_],
    span: Span,
    lookup: Lookup,
    cells: tuple[NDArray[np.float32], NDArray[np.int64]],
) -> None:
    """Sum heights (0.01 mm) and number of the ground points up to the limit of each cell; `cells`: limits, totals."""
    limits, totals = cells
    x0, y0, z0, per_metre, n_columns, _ = lookup[0]
    slot, corner_x, corner_y = 0, NOWHERE, NOWHERE
    for i in range(span[0], span[1]):
        if not ground[i]:
            continue
        ix = int((np.float64(xyz[i, 0]) - x0) * per_metre)
        iy = int((np.float64(xyz[i, 1]) - y0) * per_metre)
        if not (0 <= ix - corner_x < n_columns and 0 <= iy - corner_y < n_columns):
            slot, corner_x, corner_y = find_block(ix, iy, lookup)
        y, x = iy - corner_y, ix - corner_x
        height = np.float64(xyz[i, 2]) - z0
        if np.float32(height) <= limits[slot, y, x]:
            totals[slot, y, x, 0] += int(height * UNITS_PER_METRE + 0.5)
            totals[slot, y, x, 1] += 1


@njit(cache=True, nogil=True)
def interpolate(
    xy: NDArray[np.floating], span: Span, lookup: Lookup, nodes: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the bilinear ground height, metres above the origin of the grid; NaN outside the blocks."""
    x0, y0, _, per_metre, n_columns, _ = lookup[0]
    heights = np.full(span[1] - span[0], np.nan, dtype=np.float32)
    slot, corner_x, corner_y = 0, NOWHERE, NOWHERE
    for i in range(span[0], span[1]):
        u = (np.float64(xy[i, 0]) - x0) * per_metre
        v = (np.float64(xy[i, 1]) - y0) * per_metre
        ix, iy = int(np.floor(u)), int(np.floor(v))
        if not (0 <= ix - corner_x < n_columns and 0 <= iy - corner_y < n_columns):
            slot, corner_x, corner_y = find_block(ix, iy, lookup)
        if slot < 0:
            continue
        # Node (1, 1) is the centre of the first cell of the block.
        y, x = v - corner_y + 0.5, u - corner_x + 0.5
        row, column = int(y), int(x)
        wy, wx = np.float32(y - row), np.float32(x - column)
        below = nodes[slot, row, column] * (1 - wx) + nodes[slot, row, column + 1] * wx
        above = nodes[slot, row + 1, column] * (1 - wx) + nodes[slot, row + 1, column + 1] * wx
        heights[i - span[0]] = below * (1 - wy) + above * wy
    return heights


@njit(cache=True, nogil=True)
def heights_above(
    xyz: NDArray[np.floating], span: Span, lookup: Lookup, nodes: NDArray[np.float32], z0: float
) -> NDArray[np.float32]:
    """Return the heights of a range of points above the interpolated ground, metres."""
    heights = interpolate(xyz, span, lookup, nodes)
    for i in range(span[0], span[1]):
        heights[i - span[0]] = np.float32(np.float64(xyz[i, 2]) - z0) - heights[i - span[0]]
    return heights


CELLS_PER_BLOCK = 16
"""Cells along the side of a block."""


@dataclass(frozen=True)
class GroundSurface:
    """Ground heights on a raster of square cells, with gaps filled."""

    grid: BlockGrid  # Occupied blocks; a column is a cell
    # Ground height at the centre of each cell above the origin of the grid, metres, with a border of one cell around
    # each block. All NaN without ground points.
    nodes: NDArray[np.float32]
    known: NDArray[np.float64]  # Centres of the cells with ground points, metres from the origin of the grid
    known_heights: NDArray[np.float32]  # Their heights above the origin of the grid, metres
    n_neighbours: int  # Number of cells from which a gap is interpolated

    @classmethod
    def from_points(
        cls,
        xyz: ArrayLike,
        ground: ArrayLike,
        *,
        cell_size: float = 0.5,
        spread: float = 0.3,
        n_neighbours: int = 8,
        n_threads: int = 1,
    ) -> GroundSurface:
        """Estimate the surface from classified points.

        The height of a cell is the mean of its ground points at most `spread` above the lowest, so that misclassified
        points, such as car sills, do not raise it.
        """
        check_positive(cell_size, "cell_size")
        check_positive(spread, "spread")
        for name, value in (("n_neighbours", n_neighbours), ("n_threads", n_threads)):
            check_at_least(value, 1, name)
        points, bounds = bounds_of(xyz, n_threads)
        if len(points) == 0:
            raise DataError("xyz needs at least 1 points, got 0")
        mask = check_column(ground, len(points), "ground").astype(np.bool_)
        grid = build_blocks(points, bounds, width=cell_size, n_columns=CELLS_PER_BLOCK, n_threads=n_threads)
        heights = _cell_means(points, mask, grid, spread, n_threads)
        slots, rows, columns = np.nonzero(~np.isnan(heights))
        known = _centres(grid, slots, rows, columns)
        nodes = np.full((len(grid.keys), CELLS_PER_BLOCK + 2, CELLS_PER_BLOCK + 2), np.nan, dtype=np.float32)
        surface = cls(grid, nodes, known, heights[slots, rows, columns], n_neighbours)
        surface._fill()
        return surface

    def _fill(self) -> None:
        """Compute the height of all nodes; a border node has the value of the cell of the adjacent block."""
        slots, rows, columns = (index.ravel() for index in np.indices(self.nodes.shape))
        self.nodes[slots, rows, columns] = self._nearest(_centres(self.grid, slots, rows - 1, columns - 1))

    def _nearest(self, at: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return interpolated heights at positions relative to the origin of the grid."""
        if len(self.known) == 0:
            return np.full(len(at), np.nan, dtype=np.float32)
        k = min(self.n_neighbours, len(self.known))
        distance, index = cKDTree(self.known).query(at, k=k)
        distance, index = distance.reshape(len(at), k), index.reshape(len(at), k)
        weight = 1.0 / np.maximum(distance, 1e-6 * self.grid.width) ** 2
        return ((self.known_heights[index] * weight).sum(axis=1) / weight.sum(axis=1)).astype(np.float32)

    def elevation(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return the ground elevation at given positions, in the coordinates of the points."""
        places = np.ascontiguousarray(xy, dtype=np.float64)
        if places.ndim != 2 or places.shape[1] != 2 or not np.isfinite(places).all():
            raise DataError(f"xy must be finite of shape (m, 2), got shape {places.shape}")
        heights = interpolate(places, (0, len(places)), self.grid.lookup, self.nodes)
        outside = np.isnan(heights)
        if outside.any():
            heights[outside] = self._nearest(places[outside] - self.grid.origin[:2])
        return heights.astype(np.float64) + self.grid.origin[2]


def height_above_ground(
    xyz: ArrayLike,
    ground: ArrayLike,
    *,
    cell_size: float = 0.5,
    spread: float = 0.3,
    n_neighbours: int = 8,
    n_threads: int = 1,
) -> NDArray[np.float32]:
    """Return the height of each point above the ground.

    The ground is a `GroundSurface`, interpolated bilinearly between cell centres.
    """
    points = np.asarray(xyz)
    if points.ndim == 2 and len(points) == 0:
        check_column(ground, 0, "ground")
        return np.zeros(0, dtype=np.float32)
    surface = GroundSurface.from_points(
        points, ground, cell_size=cell_size, spread=spread, n_neighbours=n_neighbours, n_threads=n_threads
    )
    points, _ = bounds_of(points, n_threads)
    z0 = float(surface.grid.origin[2])
    parts = run_ranges(
        lambda *span: heights_above(points, span, surface.grid.lookup, surface.nodes, z0), len(points), n_threads
    )
    return parts[0] if n_threads == 1 else np.concatenate(parts)


def _centres(grid: BlockGrid, slots: NDArray, rows: NDArray, columns: NDArray) -> NDArray[np.float64]:
    """Return the centres of cells as x, y from the origin of the grid."""
    by, bx = np.divmod(grid.keys[slots], grid.stride)
    x = ((bx - 2) * grid.n_columns + columns + 0.5) * grid.width
    y = ((by - 2) * grid.n_columns + rows + 0.5) * grid.width
    return np.column_stack([x, y])


def _cell_means(
    points: NDArray[np.floating], mask: NDArray[np.bool_], grid: BlockGrid, spread: float, n_threads: int
) -> NDArray[np.float32]:
    """Return the mean height of the ground points of each cell near its lowest one; NaN without ground points."""
    shape = (len(grid.keys), grid.n_columns, grid.n_columns)

    def lowest(*span: int) -> NDArray[np.float32]:
        minima = np.full(shape, np.inf, dtype=np.float32)
        ground_minima(points, mask, span, grid.lookup, minima)
        return minima

    minima = np.minimum.reduce(run_ranges(lowest, len(points), n_threads))

    def sums(*span: int) -> NDArray[np.int64]:
        totals = np.zeros((*shape, 2), dtype=np.int64)
        ground_sums(points, mask, span, grid.lookup, (minima + np.float32(spread), totals))
        return totals

    totals = np.add.reduce(run_ranges(sums, len(points), n_threads))
    means = np.full(shape, np.nan, dtype=np.float32)
    has = totals[..., 1] > 0
    means[has] = totals[has, 0] / totals[has, 1] / UNITS_PER_METRE
    return means
