"""Reference height of the ground filter: the lowest point of a block (the paper) or a robust lower surface.

The lower surface is defined on square cells of several columns. It starts from the lowest column of each cell. Cells
above a slope-limited cone of lower cells are removed (car roofs, crowns, walls without a visible base). Cells that
continue the slope of the ground are added again (embankments). The remaining gaps are filled from their surroundings,
across block borders and one block beyond the points.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import build_table
from mlsroad_pipeline.algorithms.geometry.sorting import sort_floats
from mlsroad_pipeline.algorithms.ground.blocks import BlockGrid, neighbour_slots

SUPPORT = 0.3
"""Maximum distance above a column minimum of further minima that support it, metres; others are outliers."""


@njit(cache=True, inline="always")
def _cell(values: NDArray[np.float32], around: NDArray[np.int32], block: int, i: int, j: int) -> np.float32:
    """Return the value of a cell, also across the border of the block; NaN outside the blocks."""
    side = values.shape[1]
    down = 1 + (i >= side) - (i < 0)
    right = 1 + (j >= side) - (j < 0)
    slot = around[block, 3 * down + right]
    if slot < 0:
        return np.float32(np.nan)
    return values[slot, i - (down - 1) * side, j - (right - 1) * side]


@njit(cache=True)
def _lowest_supported(ordered: NDArray[np.float32], n: int, share: float) -> float:
    """Return the lowest of `n` ascending heights with a fraction `share` of all up to `SUPPORT` above it."""
    needed = max(share * n, np.float64(min(n, 2)))
    high = 0
    for k in range(n):
        while high < n and ordered[high] - ordered[k] <= SUPPORT:
            high += 1
        if high - k >= needed:
            return ordered[k]
    return ordered[0]


@njit(cache=True)
def cell_lows(
    minima: NDArray[np.float32], rows: NDArray[np.int64], n_cells: int, per_cell: int, share: float
) -> NDArray[np.float32]:
    """Return the lowest supported column minimum of each cell, (n_cells blocks, side, side); NaN for empty cells."""
    side = minima.shape[1] // per_cell
    lows = np.full((n_cells, side, side), np.nan, dtype=np.float32)
    heights = np.empty(per_cell * per_cell, dtype=np.float32)
    for block in range(len(minima)):
        for i in range(side):
            for j in range(side):
                n = 0
                for y in range(i * per_cell, (i + 1) * per_cell):
                    for x in range(j * per_cell, (j + 1) * per_cell):
                        if minima[block, y, x] < np.inf:
                            heights[n] = minima[block, y, x]
                            n += 1
                if n == 0:
                    continue
                sort_floats(heights, n)
                lows[rows[block], i, j] = _lowest_supported(heights, n, share)
    return lows


@njit(cache=True)
def _root(parents: NDArray[np.int64], at: int) -> int:
    while parents[at] != at:
        parents[at] = parents[parents[at]]
        at = parents[at]
    return at


@njit(cache=True)
def patch_sizes(lows: NDArray[np.float32], around: NDArray[np.int32], slope: float, step: float) -> NDArray[np.int64]:
    """Return the size of the connected patch of each cell, over rises of at most `slope` per cell plus `step`."""
    side = lows.shape[1]
    parents = np.arange(lows.size)
    for at in range(lows.size):
        block, i, j = at // (side * side), at // side % side, at % side
        for d in range(5, 9):
            di, dj = d // 3 - 1, d % 3 - 1
            z = _cell(lows, around, block, i + di, j + dj)
            if abs(z - lows[block, i, j]) <= slope * np.float32(np.hypot(di, dj)) + step:
                down, right = 1 + (i + di >= side), 1 + (j + dj >= side) - (j + dj < 0)
                row = around[block, 3 * down + right]
                other = (row * side + i + di - (down - 1) * side) * side + j + dj - (right - 1) * side
                a, b = _root(parents, at), _root(parents, other)
                parents[max(a, b)] = min(a, b)
    counts = np.zeros(lows.size, dtype=np.int64)
    for at in range(lows.size):
        counts[_root(parents, at)] += 1
    sizes = np.zeros(lows.shape, dtype=np.int64)
    for at in range(lows.size):
        if not np.isnan(lows[at // (side * side), at // side % side, at % side]):
            sizes[at // (side * side), at // side % side, at % side] = counts[_root(parents, at)]
    return sizes


@njit(cache=True)
def slope_envelope(lows: NDArray[np.float32], around: NDArray[np.int32], straight: float) -> NDArray[np.float32]:
    """Return the highest surface below all minima with a slope of at most `straight` per cell; inf if unreached."""
    side = lows.shape[1]
    envelope = lows.copy()
    flat = envelope.reshape(-1)
    for at in range(len(flat)):
        if np.isnan(flat[at]):
            flat[at] = np.inf
    changed = True
    forward = True
    while changed:
        changed = False
        for step in range(envelope.size):
            at = step if forward else envelope.size - 1 - step
            block, i, j = at // (side * side), at // side % side, at % side
            best = envelope[block, i, j]
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    rise = straight * np.float32(np.sqrt(np.float32(di * di + dj * dj)))
                    z = _cell(envelope, around, block, i + di, j + dj) + rise
                    if z < best:  # false for NaN, outside the blocks
                        best = z
                        changed = True
            envelope[block, i, j] = best
        forward = not forward
    return envelope


@njit(cache=True)
def grow_along_slope(
    lows: NDArray[np.float32], accepted: NDArray[np.bool_], around: NDArray[np.int32], step: float
) -> NDArray[np.float32]:
    """Return accepted minima (NaN elsewhere), extended by cells that continue the slope of their neighbours.

    A cell is added if it lies within `step` of the line through two accepted cells beside it in a row. Each round reads
    only the previous round, so that the order of the cells does not matter.
    """
    side = lows.shape[1]
    ground = lows.copy()
    for at in range(lows.size):
        block, i, j = at // (side * side), at // side % side, at % side
        if not accepted[block, i, j]:
            ground[block, i, j] = np.nan
    changed = True
    while changed:
        changed = False
        before = ground.copy()
        for block in range(len(lows)):
            for i in range(side):
                for j in range(side):
                    z = lows[block, i, j]
                    if np.isnan(z) or not np.isnan(before[block, i, j]):
                        continue
                    for d in range(9):
                        di, dj = d // 3 - 1, d % 3 - 1
                        near = _cell(before, around, block, i + di, j + dj)
                        far = near
                        if -side <= i + 2 * di < 2 * side and -side <= j + 2 * dj < 2 * side:
                            far = _cell(before, around, block, i + 2 * di, j + 2 * dj)
                        if d != 4 and abs(z - 2 * near + far) <= step:
                            ground[block, i, j] = z
                            changed = True
                            break
    return ground


@njit(cache=True)
def fill_from_neighbours(ground: NDArray[np.float32], around: NDArray[np.int32]) -> NDArray[np.float32]:
    """Fill empty cells iteratively by the mean of their filled neighbours."""
    side = ground.shape[1]
    filled = ground.copy()
    changed = True
    while changed:
        changed = False
        before = filled.copy()
        for block in range(len(ground)):
            for i in range(side):
                for j in range(side):
                    if not np.isnan(before[block, i, j]):
                        continue
                    total = 0.0
                    count = 0
                    for d in range(9):
                        z = _cell(before, around, block, i + d // 3 - 1, j + d % 3 - 1)
                        if not np.isnan(z):
                            total += z
                            count += 1
                    if count > 0:
                        filled[block, i, j] = np.float32(total / count)
                        changed = True
    return filled


@njit(cache=True, inline="always")
def _common_slope(before: float, here: float, after: float) -> float:
    """Return the smaller magnitude of the slopes before and after a cell; 0 if their signs differ."""
    first, second = here - before, after - here
    if first * second > 0:
        return min(abs(first), abs(second))
    return 0.0


@njit(cache=True)
def lift_to_centres(lows: NDArray[np.float32], around: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the heights at the centres of cells: on a slope, the minimum of a cell lies at its lowest corner.

    The slope is the one common to both sides of a cell, so that curbs and walls do not count.
    """
    side = lows.shape[1]
    centres = lows.copy()
    for block in range(len(lows)):
        for i in range(side):
            for j in range(side):
                z = lows[block, i, j]
                down = _common_slope(_cell(lows, around, block, i - 1, j), z, _cell(lows, around, block, i + 1, j))
                along = _common_slope(_cell(lows, around, block, i, j - 1), z, _cell(lows, around, block, i, j + 1))
                centres[block, i, j] = z + np.float32(0.5 * (down + along))
    return centres


@njit(cache=True)
def blend(cells: NDArray[np.float32], around: NDArray[np.int32], block: int, y: float, x: float) -> np.float32:
    """Return the bilinear value at (y, x) in cells from the corner of the block, or the cell value next to NaN."""
    fi, fj = np.floor(y - 0.5), np.floor(x - 0.5)
    wy, wx = np.float32(y - 0.5 - fi), np.float32(x - 0.5 - fj)
    i, j = np.int64(fi), np.int64(fj)
    z = (1 - wy) * ((1 - wx) * _cell(cells, around, block, i, j) + wx * _cell(cells, around, block, i, j + 1)) + wy * (
        (1 - wx) * _cell(cells, around, block, i + 1, j) + wx * _cell(cells, around, block, i + 1, j + 1)
    )
    if np.isnan(z):
        return cells[block, np.int64(y), np.int64(x)]
    return z


@dataclass(frozen=True)
class SurfaceParameters:
    """Parameters of the lower surface, see `classify_ground`."""

    slope: float  # Slope of the cones that limit the heights of cells, metres per metre
    step: float  # Tolerance of a cell above the cones, or from the line through its neighbours, metres
    drop: float  # Tolerance below the cones of a cell outside large patches, metres
    share: float  # Fraction of the columns of a cell that must support its lowest height, 0 to 1
    patch: float  # Minimum area of a connected patch whose cells define cones, square metres


@njit(cache=True)
def column_levels(
    rows: NDArray[np.int64], cells: NDArray[np.float32], around: NDArray[np.int32], per_cell: int
) -> NDArray[np.float32]:
    """Return the surface at the centre of each column of the occupied blocks."""
    side = cells.shape[1] * per_cell
    levels = np.empty((len(rows), side, side), dtype=np.float32)
    for block in range(len(rows)):
        for y in range(side):
            for x in range(side):
                levels[block, y, x] = blend(cells, around, rows[block], (y + 0.5) / per_cell, (x + 0.5) / per_cell)
    return levels


@njit(cache=True)
def snap_to_minima(levels: NDArray[np.float32], minima: NDArray[np.float32], step: float) -> NDArray[np.float32]:
    """Return the levels shifted by the lowest offset of the 3 x 3 column minima within `step` of their level.

    This separates the two sides of a curb, which cells blend. Offsets instead of heights preserve slopes. The
    neighbourhood ends at the border of the block.
    """
    side = levels.shape[1]
    surface = levels.copy()
    seen = np.empty((side, side), dtype=np.float32)
    for block in range(len(levels)):
        for y in range(side):
            for x in range(side):
                offset = minima[block, y, x] - levels[block, y, x]
                seen[y, x] = offset if abs(offset) <= step else np.float32(np.inf)
        for y in range(side):
            for x in range(side):
                best = np.float32(np.inf)
                for near_y in range(max(y - 1, 0), min(y + 2, side)):
                    for near_x in range(max(x - 1, 0), min(x + 2, side)):
                        best = min(best, seen[near_y, near_x])
                if best < np.inf:
                    surface[block, y, x] += best
    return surface


def lower_surface(
    grid: BlockGrid, minima: NDArray[np.float32], *, per_cell: int, parameters: SurfaceParameters
) -> NDArray[np.float32]:
    """Estimate the ground height of each column of the occupied blocks."""
    ring = (np.arange(-1, 2)[:, None] * grid.stride + np.arange(-1, 2)).ravel()
    keys = np.unique(grid.keys[:, None] + ring)
    rows = np.searchsorted(keys, grid.keys)
    around = neighbour_slots(keys, *build_table(keys), grid.stride)
    lows = cell_lows(minima, rows, len(keys), per_cell, parameters.share)
    rise = np.float32(parameters.slope * grid.width * per_cell)
    step = np.float32(parameters.step)
    sizes = patch_sizes(lows, around, rise, step)
    enough = min(parameters.patch / (grid.width * per_cell) ** 2, sizes.max())
    envelope = slope_envelope(np.where(sizes >= enough, lows, np.float32(np.nan)), around, rise)
    accepted = (lows - envelope <= step) & (lows - envelope >= -parameters.drop)
    ground = grow_along_slope(lows, accepted, around, step)
    cells = lift_to_centres(fill_from_neighbours(ground, around), around)
    return snap_to_minima(column_levels(rows, cells, around, per_cell), minima, step)


def block_surface(minima: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the lowest height of each block for all of its columns (the reference of the paper)."""
    lowest = minima.min(axis=(1, 2), keepdims=True)
    return np.ascontiguousarray(np.broadcast_to(lowest, minima.shape))
