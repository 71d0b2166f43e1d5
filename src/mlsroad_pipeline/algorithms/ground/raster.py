"""Kernels of the ground raster: sums of heights per cell, and bilinear interpolation between cell centres."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.ground.blocks import NOWHERE, Lookup, find_block
from mlsroad_pipeline.algorithms.ground.spans import Span

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
