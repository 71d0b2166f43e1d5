"""Surface of the road: heights of the ground by station and offset, planes, ruts and evenness."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.road.stations import REACH, STEP, Located

CELL = 0.1
"""Width of a cell across the path, metres."""
CELLS = round(2 * REACH / CELL)
LANE = 1.5
"""Half width of the strip around the path whose plane gives crossfall and slope, metres."""
WINDOW = 2
"""Stations before and after a station that its plane is fitted to."""
WHEEL = 0.75
"""Distance of the wheel paths from the path, metres."""

_ALONG = 4  # cells of the right wheel path per station
_HALF_WHEEL = 0.2  # half width of a wheel path, metres
_RUT, _LEAST_RUT = 1.75, 1.2  # ruts are measured up to here from the path, and if the profile reaches so far, metres
_GUTTER = 0.4  # distance from the edges of the carriageway within which its surface is not measured, metres
_LATH, _LONG_LATH = 2.0, 4.0  # straightedges across and along the road, metres
_LEAST = 5  # points of a cell of a profile under a straightedge
_CERTAIN = 0.0015  # largest median standard error of the heights of such a profile, metres
_STRAY, _BENT = 0.1, 0.05  # deviation of the road from its plane on the path, and per metre beside it, metres
_STEPS = 8  # of the fit of a plane
_BOUND = 0.02  # residuals above this have no weight, metres


class Ground(NamedTuple):
    """Ground points by station and cell: number, mean height, mean station, sum of squared deviations, natural ones."""

    number: NDArray[np.int32]  # (stations, CELLS)
    height: NDArray[np.float64]  # Above the height `base`
    place: NDArray[np.float32]  # Metres after the middle of the station
    squares: NDArray[np.float32]
    natural: NDArray[np.int32]
    wheel: NDArray[np.float64]  # Right wheel path, (stations * _ALONG, 4): the first four, in this order
    base: float

    @classmethod
    def empty(cls, stations: int, base: float) -> "Ground":
        """Return the ground before the first point."""
        size = (stations, CELLS)
        return cls(
            np.zeros(size, np.int32), np.zeros(size), np.zeros(size, np.float32), np.zeros(size, np.float32),
            np.zeros(size, np.int32), np.zeros((stations * _ALONG, 4)), base,
        )  # fmt: skip

    def add(self, places: Located, z: NDArray[np.float64], natural: NDArray[np.bool_]) -> None:
        """Add points, in place; `z` and `natural` are those of the located rows."""
        arrays = (self.number, self.height, self.place, self.squares, self.natural, self.wheel)
        _add(places.station / STEP, places.offset, z - self.base, natural, *arrays)


@njit(cache=True, nogil=True)
def _add(
    station: NDArray, offset: NDArray, z: NDArray, natural: NDArray,
    count: NDArray, height: NDArray, place: NDArray, squares: NDArray, naturals: NDArray, wheel: NDArray,
) -> None:  # fmt: skip
    """Add points to the running means and squares (Welford)."""
    for p in range(len(station)):
        i, c = int(station[p]), int((offset[p] + REACH) / CELL)
        if not (0 <= i < len(count) and 0 <= c < CELLS):
            continue
        count[i, c] += 1
        step = z[p] - height[i, c]
        height[i, c] += step / count[i, c]
        squares[i, c] += step * (z[p] - height[i, c])
        place[i, c] += ((station[p] - i - 0.5) * STEP - place[i, c]) / count[i, c]
        naturals[i, c] += natural[p]
        if abs(offset[p] - WHEEL) < _HALF_WHEEL and not natural[p]:
            cell = wheel[int(station[p] * _ALONG)]
            cell[0] += 1
            step = z[p] - cell[1]
            cell[1] += step / cell[0]
            cell[2] += ((station[p] - i - 0.5) * STEP - cell[2]) / cell[0]
            cell[3] += step * (z[p] - cell[1])


class Planes(NamedTuple):
    """Robust planes of the paved ground around the path, by station; NaN where it was not seen."""

    height: NDArray[np.float64]  # At the middle of the station, on the path
    slope: NDArray[np.float64]  # Along the path, rising is positive
    crossfall: NDArray[np.float64]  # Falling to the right is positive


def strip_cells(edges: NDArray[np.float64], half: float) -> NDArray[np.int64]:
    """Return the first cell of a strip around the path in each station, and the one after the last, shape (2, n).

    The strip keeps away from the gutters; `edges` are offsets of the left and right edge, NaN where none is seen.
    """
    low, high = np.fmax(-half, edges[0] + _GUTTER), np.fmin(half, edges[1] - _GUTTER)
    return np.round((np.stack([low, high]) + REACH) / CELL).astype(np.int64)


def fit_planes(ground: Ground, edges: NDArray[np.float64]) -> Planes:
    """Return the planes of all stations; `edges` are the offsets of the left and right edge, NaN without."""
    strip = strip_cells(edges, LANE)
    return Planes(*_planes(ground.number, ground.height, ground.place, ground.natural, strip).T)


@njit(cache=True, nogil=True)
def _planes(
    count: NDArray, height: NDArray, place: NDArray, natural: NDArray, strip: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Fit planes to the cells of five stations by reweighted least squares (Tukey's biweight)."""
    n = len(count)
    found = np.full((n, 3), np.nan)
    most = (2 * WINDOW + 1) * (round(2 * LANE / CELL) + 1)
    x, y, z = np.empty(most), np.empty(most), np.empty(most)
    for i in range(n):
        m = 0
        for k in range(max(i - WINDOW, 0), min(i + WINDOW + 1, n)):
            for c in range(strip[0, i], strip[1, i]):
                if count[k, c] > 2 * natural[k, c]:
                    x[m], y[m], z[m] = (k - i) * STEP + place[k, c], (c + 0.5) * CELL - REACH, height[k, c]
                    m += 1
        if m < most // 5 or x[:m].max() - x[:m].min() < STEP or y[:m].max() - y[:m].min() < LANE:
            continue
        found[i] = _plane(x[:m], y[:m], z[:m])
    return found


@njit(cache=True, nogil=True)
def _plane(x: NDArray, y: NDArray, z: NDArray) -> NDArray[np.float64]:
    """Return height, slope along and fall across of a plane."""
    solution = np.array([np.median(z), 0.0, 0.0])
    bound = 0.3  # the first bounds are wide, since the first plane is level
    for _ in range(_STEPS):
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for p in range(len(x)):
            residual = z[p] - solution[0] - solution[1] * x[p] + solution[2] * y[p]
            share = residual / bound
            if abs(share) >= 1.0:
                continue
            weight = (1.0 - share * share) ** 2
            row = np.array([1.0, x[p], -y[p]])
            for a in range(3):
                right[a] += weight * row[a] * z[p]
                for b in range(3):
                    normal[a, b] += weight * row[a] * row[b]
        if abs(np.linalg.det(normal)) < 1e-6:
            return np.full(3, np.nan)
        solution = np.linalg.solve(normal, right)
        bound = max(bound / 2.0, _BOUND)
    return solution


def surface_heights(ground: Ground, planes: Planes) -> NDArray[np.float64]:
    """Return the height of the ground at the middle of each station and cell; NaN in stations without a plane.

    Cells without points, or with heights far from the plane, such as those of reflections under vehicles, are
    interpolated; beyond the outermost ones the plane continues.
    """
    offset = (np.arange(CELLS) + 0.5) * CELL - REACH
    flat = planes.height[:, None] - planes.crossfall[:, None] * offset
    level = ground.height - planes.slope[:, None] * ground.place - flat
    sound = (ground.number > 0) & (np.abs(level) < _STRAY + _BENT * np.abs(offset))
    for i in np.flatnonzero(sound.any(axis=1)):
        known = np.flatnonzero(sound[i])
        flat[i] += np.interp(np.arange(CELLS), known, level[i, known])
    return flat


def ruts(ground: Ground, planes: Planes, edges: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the depths of the left and of the right rut, metres; NaN where the profile is not dense enough."""
    depth = np.full((2, len(planes.slope)), np.nan)
    for i, (first, last) in enumerate(strip_cells(edges, _RUT).T):
        part = slice(first, last)
        reaches = REACH - first * CELL >= _LEAST_RUT, last * CELL - REACH >= _LEAST_RUT
        known = np.isfinite(planes.slope[i]) and last > first
        certain = known and _is_certain(ground.number[i, part], ground.squares[i, part], planes.slope[i] * STEP)
        if certain:
            gaps = lath_gaps(ground.height[i, part] - planes.slope[i] * ground.place[i, part], round(_LATH / CELL) + 1)
            left = (np.arange(first, last) + 0.5) * CELL < REACH
            for side, own in enumerate((left, ~left)):
                depth[side, i] = gaps[own].max() if reaches[side] else np.nan
    return depth[0], depth[1]


def evenness(ground: Ground, planes: Planes) -> NDArray[np.float64]:
    """Return the largest gap under a straightedge along the right wheel path in each station, metres."""
    n, size = len(planes.slope), round(_LONG_LATH / STEP * _ALONG) + 1
    count, height, place, squares = ground.wheel.T
    at = (np.arange(n * _ALONG) % _ALONG + 0.5) / _ALONG * STEP - STEP / 2
    level = height - np.repeat(planes.slope, _ALONG) * (place - at)
    out = np.full(n, np.nan)
    for i in range(WINDOW, n - WINDOW):
        part = slice((i - WINDOW) * _ALONG, (i + WINDOW + 1) * _ALONG)
        if _is_certain(count[part], squares[part], planes.slope[i] * STEP / _ALONG) and np.isfinite(level[part]).all():
            out[i] = lath_gaps(level[part], size)[WINDOW * _ALONG : (WINDOW + 1) * _ALONG].max()
    return out


def _is_certain(count: NDArray, squares: NDArray, rise: float) -> bool:
    """Return whether a profile has points in all cells, and heights that are certain enough.

    `rise` is that of the road along a cell, whose share of the variance is no noise.
    """
    if (count < _LEAST).any():
        return False
    variance = np.maximum(squares / (count - 1) - rise**2 / 12, 0.0)
    return bool(np.median(np.sqrt(variance / count)) <= _CERTAIN)


@njit(cache=True, nogil=True)
def lath_gaps(level: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return the largest gap of each place of a profile below straightedges of `size` places that lie on it."""
    n = len(level)
    gaps = np.zeros(n)
    for first in range(max(n - size + 1, 1)):
        last = min(first + size, n) - 1
        at = first
        while at < last:  # from one place that the straightedge may lie on to the next: the upper hull
            best, steepest = last, -np.inf
            for k in range(at + 1, last + 1):
                slope = (level[k] - level[at]) / (k - at)
                if slope >= steepest:
                    best, steepest = k, slope
            for k in range(at + 1, best):
                gaps[k] = max(gaps[k], level[at] + steepest * (k - at) - level[k])
            at = best
    return gaps
