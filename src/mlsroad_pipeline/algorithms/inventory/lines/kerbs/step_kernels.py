"""Cells of the ground, and kernels that fit a plane with a jump around each, see `steps`."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import CellGrid, build_cell_grids, gather_cells

CELL = 0.1
"""Edge of a cell, metres: a third of the narrowest kerb stone, so that a kerb is one step between two cells."""

BLOCK = 0.5
"""Edge of the coarse grid, metres."""

_BAND = 0.05  # metres above the lowest point of a cell: the foot of a kerb, not grass or a wheel above it


@dataclass(frozen=True)
class GroundCells:
    """Occupied cells of the ground of a scene."""

    xyz: NDArray[np.float64]  # Mean of the points up to 5 cm above the lowest of each cell, metres
    points: CellGrid  # The points, sorted into the cells
    blocks: CellGrid  # The cells, sorted into squares of `BLOCK`


def ground_cells(xyz: NDArray[np.floating]) -> GroundCells:
    """Return the cells of the ground."""
    flat = np.array(xyz, dtype=np.float64)
    flat[:, 2] = 0.0
    (points,) = build_cell_grids(flat, cell_size=CELL)
    cells = _lowest(np.ascontiguousarray(xyz, dtype=np.float64), points.order, points.starts)
    plan = cells.copy()
    plan[:, 2] = 0.0
    (blocks,) = build_cell_grids(plan, cell_size=BLOCK, margin=2)
    return GroundCells(cells, points, blocks)


@njit(cache=True, nogil=True)
def _lowest(xyz: NDArray, order: NDArray, starts: NDArray) -> NDArray[np.float64]:
    means = np.zeros((len(starts) - 1, 3))
    for cell in range(len(means)):
        low = np.inf
        for i in range(starts[cell], starts[cell + 1]):
            low = min(low, xyz[order[i], 2])
        count = 0
        for i in range(starts[cell], starts[cell + 1]):
            if xyz[order[i], 2] <= low + _BAND:
                count += 1
                for axis in range(3):
                    means[cell, axis] += xyz[order[i], axis]
        for axis in range(3):
            means[cell, axis] /= count
    return means


MOST_CELLS = (5 * round(BLOCK / CELL) + 2) ** 2  # the edges of blocks are not those of cells
"""Largest number of cells in 5 by 5 blocks."""

REACH = 0.7
"""Radius of the fit, metres."""

_HALF_LENGTH = 0.5  # of the strip along the edge, metres
_GAP = 0.06  # cells nearer to the edge hold its face, metres
_SHIFT = 0.05  # an edge farther from the cell belongs to the next one, metres
_LEAST = 4  # cells on either side
_NEAR = 0.4  # radius of the plane that gives the direction, metres
_FLATTEST = 0.04  # slope of that plane
_OUTLIER = (0.06, 0.04)  # metres
_INLIERS = 0.7
_TURNS = (0.0, 0.2, -0.2, 0.4, -0.4)  # radians from the steepest direction
_FINE = 0.25  # reach of the points that place the edge, metres
_BINS = 50
_FARTHEST = 0.15  # metres
_RISE = 0.6  # largest difference in height to the cell, metres


@njit(cache=True, nogil=True)
def _strip(local: NDArray, count: int, c: float, s: float, strip: NDArray) -> int:
    """Write u, v and z of the cells along an edge of one direction into `strip`, and return their number."""
    n = 0
    for i in range(count):
        v = local[1, i] * c - local[0, i] * s
        if abs(v) <= _HALF_LENGTH:
            strip[0, n], strip[1, n], strip[2, n] = local[0, i] * c + local[1, i] * s, v, local[2, i]
            n += 1
    return n


@njit(cache=True, nogil=True)
def _sums(strip: NDArray, n: int, shift: float, solution: NDArray, bound: float, normal: NDArray) -> tuple[int, int]:
    """Write the normal equations of z = a + b u + c v + s [u > 0], and return the numbers of cells on either side.

    With a positive bound, cells farther from the solution are left out. The sums are variables, which the compiler
    keeps in registers.
    """
    low = high = 0
    u_1 = v_1 = h_1 = z_1 = uu = uv = uh = uz = vv = vh = vz = hz = zz = 0.0
    for i in range(n):
        u, v, z = strip[0, i] - shift, strip[1, i], strip[2, i]
        if abs(u) < _GAP:
            continue
        h = 1.0 if u > 0 else 0.0
        if bound > 0.0 and abs(z - (solution[0] + solution[1] * u + solution[2] * v + solution[3] * h)) > bound:
            continue
        high, low = high + int(h), low + 1 - int(h)
        u_1, v_1, h_1, z_1 = u_1 + u, v_1 + v, h_1 + h, z_1 + z
        uu, uv, uh, uz = uu + u * u, uv + u * v, uh + u * h, uz + u * z
        vv, vh, vz, hz, zz = vv + v * v, vh + v * h, vz + v * z, hz + h * z, zz + z * z
    normal[0, 0], normal[0, 1], normal[0, 2], normal[0, 3], normal[0, 4] = low + high, u_1, v_1, h_1, z_1
    normal[1, 1], normal[1, 2], normal[1, 3], normal[1, 4] = uu, uv, uh, uz
    normal[2, 2], normal[2, 3], normal[2, 4] = vv, vh, vz
    normal[3, 3], normal[3, 4], normal[4, 4] = h_1, hz, zz
    return low, high


@njit(cache=True, nogil=True)
def _solve(normal: NDArray, solution: NDArray) -> float:
    """Solve the normal equations by elimination, and return the sum of squares of the residuals."""
    work = normal.copy()
    for a in range(4):
        work[a, a] += 1e-3 if a in (1, 2) else 1e-9  # keeps slopes of few cells small
        for b in range(a):
            work[a, b] = work[b, a]
    for a in range(4):
        for b in range(a + 1, 4):
            factor = work[b, a] / work[a, a]
            for c in range(a, 5):
                work[b, c] -= factor * work[a, c]
    rest = normal[4, 4]
    for a in range(3, -1, -1):
        value = work[a, 4]
        for b in range(a + 1, 4):
            value -= work[a, b] * solution[b]
        solution[a] = value / work[a, a]
        rest -= solution[a] * normal[a, 4]
    return max(rest, 0.0)


@njit(cache=True, nogil=True)
def _is_supported(strip: NDArray, n: int, shift: float) -> bool:
    """Return whether enough cells lie on either side of an edge, not all at one place along it."""
    n_low = n_high = 0
    first_low = first_high = 9.0
    last_low = last_high = -9.0
    for i in range(n):
        u, v = strip[0, i] - shift, strip[1, i]
        if u >= _GAP:
            n_high, first_high, last_high = n_high + 1, min(first_high, v), max(last_high, v)
        elif u <= -_GAP:
            n_low, first_low, last_low = n_low + 1, min(first_low, v), max(last_low, v)
    return min(n_low, n_high) >= _LEAST and min(last_low - first_low, last_high - first_high) >= 0.25


@njit(cache=True, nogil=True)
def _one_fit(strip: NDArray, n: int, shift: float, robust: float, normal: NDArray, solution: NDArray) -> float:
    """Fit the step along one direction; return the root mean square residual, infinite where it is not supported.

    Outliers are removed with a positive `robust`, which is no boolean: each literal would compile a version of its own.
    """
    if not _is_supported(strip, n, shift):
        return np.inf
    low, high = _sums(strip, n, shift, solution, 0.0, normal)
    total = low + high
    rest = _solve(normal, solution)
    if robust == 0.0:
        return np.sqrt(rest / total)
    for bound in _OUTLIER:
        low, high = _sums(strip, n, shift, solution, bound, normal)
        if min(low, high) < _LEAST:
            return np.inf
        rest = _solve(normal, solution)
    if low + high < _INLIERS * total:
        return np.inf
    return np.sqrt(rest / (low + high)) + 0.05 * (1.0 - (low + high) / total)


@njit(cache=True, nogil=True)
def _steepest(local: NDArray, count: int) -> tuple[float, float]:
    """Return slope and direction of the plane through the cells nearby, slope 0 without enough of them."""
    m = np.zeros(9)
    for i in range(count):
        x, y, z = local[0, i], local[1, i], local[2, i]
        if x * x + y * y < _NEAR * _NEAR:
            for k, value in enumerate((1.0, x, y, z, x * x, y * y, x * y, x * z, y * z)):
                m[k] += value
    if m[0] < 5:
        return 0.0, 0.0
    for k in range(1, 9):
        m[k] /= m[0]
    xx, yy, xy = m[4] - m[1] * m[1] + 1e-4, m[5] - m[2] * m[2] + 1e-4, m[6] - m[1] * m[2]
    xz, yz = m[7] - m[1] * m[3], m[8] - m[2] * m[3]
    det = xx * yy - xy * xy
    gx, gy = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    return np.hypot(gx, gy), np.arctan2(gy, gx)


@njit(cache=True, nogil=True)
def _best(local: NDArray, count: int, least: float, strip: NDArray, row: NDArray) -> None:
    """Write height, direction, roughness, shift, slopes and height of the foot of the best step into `row`."""
    slope, base = _steepest(local, count)
    if slope < _FLATTEST:
        return
    normal, solution = np.zeros((5, 5)), np.zeros(4)
    n = _strip(local, count, np.cos(base), np.sin(base), strip)
    # Most cells end here: without outliers removed, a step is a little lower.
    if _one_fit(strip, n, 0.0, 0.0, normal, solution) == np.inf or solution[3] < 0.5 * least:
        return
    best, shifted = np.inf, 0.0
    for turn in _TURNS:
        c, s = np.cos(base + turn), np.sin(base + turn)
        n = _strip(local, count, c, s, strip)
        for shift in (0.0, -_SHIFT, _SHIFT):
            rough = _one_fit(strip, n, shift, 1.0, normal, solution)
            if rough < best:
                best, shifted = rough, shift
                row[0], row[1], row[2], row[3], row[4] = solution[3], c, s, rough, shift
                row[5], row[6], row[7] = solution[1], solution[2], solution[0]
    if shifted != 0.0:
        row[0] = 0.0


@njit(cache=True, nogil=True)
def _placed(
    near: NDArray, count: int, origin: NDArray, row: NDArray, order: NDArray, starts: NDArray, xyz: NDArray
) -> float:
    """Return the place of the foot across the edge: points before it lie on the lower plane, none behind it does."""
    costs = np.zeros((_BINS, 3))
    for k in range(count):
        cell = near[k]
        for i in range(starts[cell], starts[cell + 1]):
            x, y = xyz[order[i], 0] - origin[0], xyz[order[i], 1] - origin[1]
            u, v = x * row[1] + y * row[2], y * row[1] - x * row[2]
            z = xyz[order[i], 2] - origin[2] - row[7] - row[5] * u - row[6] * v
            if abs(u) < _FINE and abs(v) < _FINE and abs(z) < row[0] + 0.1:
                b = min(int((u + _FINE) / (2 * _FINE) * _BINS), _BINS - 1)
                costs[b, 0] += 1.0
                costs[b, 1] += min(z, row[0]) ** 2
                costs[b, 2] += max(0.5 * row[0] - z, 0.0) ** 2
    total, cost = 0.0, 0.0
    for b in range(_BINS):
        total, cost = total + costs[b, 0], cost + costs[b, 2]
    n = 0.0
    best, place = np.inf, 0.0
    for b in range(_BINS - 1):
        n, cost = n + costs[b, 0], cost + costs[b, 1] - costs[b, 2]
        if n >= 3 and total - n >= 3 and cost < best - 1e-12:
            best, place = cost, (b + 1.0) / _BINS * 2 * _FINE - _FINE
    return place


@njit(cache=True, nogil=True)
def _within_reach(cells: NDArray, members: NDArray, around: NDArray, n: int, close: NDArray) -> int:
    """Write the cells that `_rise` may need for the cells of a block into `close`, and return their number."""
    reach = _NEAR + 1e-6
    west, east, south, north = np.inf, -np.inf, np.inf, -np.inf
    for own in members:
        west, east = min(west, cells[own, 0] - reach), max(east, cells[own, 0] + reach)
        south, north = min(south, cells[own, 1] - reach), max(north, cells[own, 1] + reach)
    count = 0
    for k in range(n):
        x, y = around[0, k], around[1, k]
        close[0, count], close[1, count], close[2, count] = x, y, around[2, k]
        count += int((x >= west) & (x <= east) & (y >= south) & (y <= north))
    return count


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})  # lets the compiler use vector instructions; sums are exact
def _rise(around: NDArray, n: int, x: float, y: float, z: float) -> float:
    """Return the difference in height of the cells near a place."""
    low, high = np.inf, -np.inf
    for k in range(n):
        dx, dy, dz = around[0, k] - x, around[1, k] - y, around[2, k] - z
        inside = (dx * dx + dy * dy < _NEAR * _NEAR) & (abs(dz) < _RISE)
        low, high = min(low, dz if inside else np.inf), max(high, dz if inside else -np.inf)
    return high - low


@njit(cache=True, nogil=True)
def fit_steps(
    cells: NDArray, order: NDArray, keys: NDArray, starts: NDArray, nx: int, least: float,
    point_order: NDArray, point_starts: NDArray, xyz: NDArray, wanted: NDArray[np.bool_],
) -> NDArray[np.float64]:  # fmt: skip
    """Return height, direction, roughness, shift, slopes and height of the foot of the step at each cell, or zeros.

    Cells that are not wanted have zeros.
    """
    fits = np.zeros((len(cells), 8))
    found, near = np.empty(MOST_CELLS, np.int64), np.empty(MOST_CELLS, np.int64)
    around, local, strip = np.empty((3, MOST_CELLS)), np.empty((3, MOST_CELLS)), np.empty((3, MOST_CELLS))
    close = np.empty((3, MOST_CELLS))
    for block in range(len(keys)):
        n_found = gather_cells(keys[block], nx, np.int64(2), keys, starts, order, found)
        for axis in range(3):
            for k in range(n_found):
                around[axis, k] = cells[found[k], axis]
        n_close = _within_reach(cells, order[starts[block] : starts[block + 1]], around, n_found, close)
        for i in range(starts[block], starts[block + 1]):
            own = order[i]
            if not wanted[own]:
                continue
            if not _rise(close, n_close, cells[own, 0], cells[own, 1], cells[own, 2]) >= least:
                continue
            count = np.int64(0)  # a literal would compile a second version of three kernels
            for k in range(n_found):
                x, y, z = around[0, k] - cells[own, 0], around[1, k] - cells[own, 1], around[2, k] - cells[own, 2]
                if x * x + y * y < REACH * REACH and abs(z) < _RISE:
                    local[0, count], local[1, count], local[2, count], near[count] = x, y, z, found[k]
                    count += 1
            row = fits[own]
            _best(local, count, least, strip, row)
            if row[0] >= least:
                row[4] = _placed(near, count, cells[own], row, point_order, point_starts, xyz)
                row[7] += cells[own, 2]
                if abs(row[4]) > _FARTHEST:  # the edge is that of another cell
                    row[0] = 0.0
    return fits
