"""Steps in the ground: a plane with a jump, fitted around each cell."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.inventory.block_search import gather_cells
from mlsroad_pipeline.algorithms.inventory.kerbs.ground_cells import MOST_CELLS, GroundCells

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


@dataclass(frozen=True)
class StepLimits:
    """Limits of a kerb's step.

    Parameters
    ----------
    least_height, most_height : float
        Height of the step, metres. A smaller least height finds dropped kerbs and the edges of grass, too.
    roughness : float
        Largest root mean square distance from the two planes, metres. Larger accepts grass and rough edges.
    relative_roughness : float
        The same as a share of the height; the larger of both counts.
    slope : float
        Largest slope of the ground on both sides.

    Raises
    ------
    ParameterError
        If a limit is not positive, or the heights are not in order.
    """

    least_height: float = 0.05
    most_height: float = 0.3
    roughness: float = 0.02
    relative_roughness: float = 0.25
    slope: float = 0.2

    def __post_init__(self) -> None:
        for name in ("least_height", "most_height", "roughness", "relative_roughness", "slope"):
            check_positive(getattr(self, name), name)
        if self.least_height > self.most_height:
            raise ParameterError(f"least_height {self.least_height} is above most_height {self.most_height}")


@dataclass(frozen=True)
class Steps:
    """Steps in the ground, one for each cell on an edge.

    Parameters
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Place on the edge and height of the ground at its foot, metres.
    upward : ndarray of float64, shape (n, 2)
        Unit vectors in plan across the edge, towards the upper side.
    height : ndarray of float64, shape (n,)
        Height of the step, metres.
    roughness : ndarray of float64, shape (n,)
        Root mean square distance from the planes, metres.
    cell : ndarray of int64, shape (n,)
        Row of the step's cell in `GroundCells`; empty for steps of several scenes.
    """

    xyz: NDArray[np.float64]
    upward: NDArray[np.float64]
    height: NDArray[np.float64]
    roughness: NDArray[np.float64]
    cell: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def find_steps(cells: GroundCells, xyz: NDArray[np.floating], limits: StepLimits) -> Steps:
    """Return the steps of the ground.

    Around each cell with a difference in height, a plane with a jump along a line is fitted by least squares, twice
    without the cells far from it. The line goes through the cell; of several directions the smallest residual counts.

    Parameters
    ----------
    cells : GroundCells
        Cells of the ground.
    xyz : ndarray, shape (n, 3)
        The points of the cells, metres; they place the edge within a centimetre.
    limits : StepLimits
        Limits of a step.

    Returns
    -------
    Steps
        One for each cell on an edge.
    """
    blocks, points = cells.blocks, cells.points
    fits = _fit(
        cells.xyz,
        *(blocks.order, blocks.keys, blocks.starts, blocks.shape[0], limits.least_height),
        *(points.order, points.starts, np.ascontiguousarray(xyz, dtype=np.float64)),
    )
    height, rough, slope = fits[:, 0], fits[:, 3], np.hypot(fits[:, 5], fits[:, 6])
    kept = (height >= limits.least_height) & (height <= limits.most_height) & (slope <= limits.slope)
    kept &= rough <= np.maximum(limits.roughness, limits.relative_roughness * height)
    rows = np.flatnonzero(kept)
    place = cells.xyz[rows]
    place[:, :2] += fits[rows, 4:5] * fits[rows, 1:3]
    place[:, 2] = fits[rows, 7]
    return Steps(place, fits[rows, 1:3], height[rows], rough[rows], rows)


@njit(cache=True, nogil=True)
def _add(normal: NDArray, u: float, v: float, z: float) -> None:
    """Add a cell to the normal equations of z = a + b u + c v + s [u > 0]."""
    h = 1.0 if u > 0 else 0.0
    row = (1.0, u, v, h, z)
    for a in range(4):
        for b in range(a, 5):
            normal[a, b] += row[a] * row[b]
    normal[4, 4] += z * z


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
def _one_fit(local: NDArray, count: int, c: float, s: float, shift: float, robust: bool, solution: NDArray) -> float:
    """Fit the step along one direction; return the root mean square residual, infinite where it is not supported."""
    normal = np.zeros((5, 5))
    total, low, high = 0, 0, 0
    span = np.array([[9.0, -9.0], [9.0, -9.0]])
    for i in range(count):
        u, v = local[i, 0] * c + local[i, 1] * s - shift, local[i, 1] * c - local[i, 0] * s
        if abs(v) > _HALF_LENGTH or abs(u) < _GAP:
            continue
        side = 1 if u > 0 else 0
        low, high = low + 1 - side, high + side
        span[side, 0], span[side, 1] = min(span[side, 0], v), max(span[side, 1], v)
        _add(normal, u, v, local[i, 2])
    total = low + high
    if min(low, high) < _LEAST or span[0, 1] - span[0, 0] < 0.25 or span[1, 1] - span[1, 0] < 0.25:
        return np.inf
    rest = _solve(normal, solution)
    if not robust:
        return np.sqrt(rest / total)
    for bound in _OUTLIER:
        normal[:] = 0.0
        low = high = 0
        for i in range(count):
            u, v = local[i, 0] * c + local[i, 1] * s - shift, local[i, 1] * c - local[i, 0] * s
            if abs(v) > _HALF_LENGTH or abs(u) < _GAP:
                continue
            side = 1 if u > 0 else 0
            expected = solution[0] + solution[1] * u + solution[2] * v + solution[3] * side
            if abs(local[i, 2] - expected) <= bound:
                low, high = low + 1 - side, high + side
                _add(normal, u, v, local[i, 2])
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
        x, y, z = local[i, 0], local[i, 1], local[i, 2]
        if x * x + y * y < _NEAR * _NEAR:
            for k, value in enumerate((1.0, x, y, z, x * x, y * y, x * y, x * z, y * z)):
                m[k] += value
    if m[0] < 5:
        return 0.0, 0.0
    m[1:] /= m[0]
    xx, yy, xy = m[4] - m[1] * m[1] + 1e-4, m[5] - m[2] * m[2] + 1e-4, m[6] - m[1] * m[2]
    xz, yz = m[7] - m[1] * m[3], m[8] - m[2] * m[3]
    det = xx * yy - xy * xy
    gx, gy = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    return np.hypot(gx, gy), np.arctan2(gy, gx)


@njit(cache=True, nogil=True)
def _best(local: NDArray, count: int, least: float, row: NDArray) -> None:
    """Write height, direction, roughness, shift, slopes and height of the foot of the best step into `row`."""
    slope, base = _steepest(local, count)
    if slope < _FLATTEST:
        return
    solution = np.zeros(4)
    # Most cells end here: without outliers removed, a step is a little lower.
    if _one_fit(local, count, np.cos(base), np.sin(base), 0.0, False, solution) == np.inf or solution[3] < 0.5 * least:
        return
    best, shifted = np.inf, 0.0
    for turn in _TURNS:
        c, s = np.cos(base + turn), np.sin(base + turn)
        for shift in (0.0, -_SHIFT, _SHIFT):
            rough = _one_fit(local, count, c, s, shift, True, solution)
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
    total = costs.sum(axis=0)
    n, cost = 0.0, total[2]
    best, place = np.inf, 0.0
    for b in range(_BINS - 1):
        n, cost = n + costs[b, 0], cost + costs[b, 1] - costs[b, 2]
        if n >= 3 and total[0] - n >= 3 and cost < best - 1e-12:
            best, place = cost, (b + 1.0) / _BINS * 2 * _FINE - _FINE
    return place


@njit(cache=True, nogil=True)
def _fit(
    cells: NDArray, order: NDArray, keys: NDArray, starts: NDArray, nx: int, least: float,
    point_order: NDArray, point_starts: NDArray, xyz: NDArray,
) -> NDArray[np.float64]:  # fmt: skip
    fits = np.zeros((len(cells), 8))
    found, near = np.empty(MOST_CELLS, np.int64), np.empty(MOST_CELLS, np.int64)
    local = np.empty((MOST_CELLS, 3))
    for block in range(len(keys)):
        n_found = gather_cells(keys[block], nx, 2, keys, starts, order, found)
        for i in range(starts[block], starts[block + 1]):
            own = order[i]
            count, low, high = 0, np.inf, -np.inf
            for k in range(n_found):
                cell = found[k]
                for axis in range(3):
                    local[count, axis] = cells[cell, axis] - cells[own, axis]
                x, y, z = local[count]
                if x * x + y * y < REACH * REACH and abs(z) < 0.6:
                    if x * x + y * y < _NEAR * _NEAR:
                        low, high = min(low, z), max(high, z)
                    near[count] = cell
                    count += 1
            if high - low < least:
                continue
            row = fits[own]
            _best(local, count, least, row)
            if row[0] >= least:
                row[4] = _placed(near, count, cells[own], row, point_order, point_starts, xyz)
                row[7] += cells[own, 2]
                if abs(row[4]) > _FARTHEST:  # the edge is that of another cell
                    row[0] = 0.0
    return fits
