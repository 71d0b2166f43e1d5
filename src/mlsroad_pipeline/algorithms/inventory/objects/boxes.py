"""Outlines in plan: convex hull, rectangle of minimum area, and box of a vehicle."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

_NEAR_EDGE = 0.05  # lower bound of distances to an edge, metres: d0 of Zhang et al. 2017, algorithm 4
_STRAY = 0.004  # share of points outside each side: aerials, mixed pixels, mirrors
_STRAY_ENDS = 0.0015  # share of points outside each end, which has no mirrors
# Reach and step of the search over directions, degrees, and the number of points used.
_STEPS = ((45.0, 2.0, 300), (2.0, 0.2, 600), (0.2, 0.04, 1200))


class Box(NamedTuple):
    """Rectangle in plan."""

    centre: NDArray[np.float64]  # Centre, metres
    # length, width: longer and shorter side, metres
    length: float
    width: float
    azimuth: float  # Direction of the longer side, degrees clockwise from north, 0 to 180


def trimmed(values: NDArray[np.float64], share: float) -> tuple[float, float]:
    """Return the trimmed limits of values."""
    flat = values.ravel()
    stray = int(share * len(flat))
    part = np.partition(flat, (stray, len(flat) - 1 - stray))
    return float(part[stray]), float(part[len(flat) - 1 - stray])


def convex_hull(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the convex hull of points in plan."""
    outer = xy[_outside(xy)]
    return _hull(outer[np.lexsort((outer[:, 1], outer[:, 0]))])


@njit(cache=True)
def _outside(xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the points outside the octagon of the extreme points (Akl and Toussaint 1978)."""
    corner = np.zeros(8, np.int64)
    reach = np.full(8, -np.inf)
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        for way, far in enumerate((x, x + y, y, y - x, -x, -x - y, -y, x - y)):
            if far > reach[way]:
                reach[way], corner[way] = far, i
    ax, ay, ex, ey = np.empty(8), np.empty(8), np.empty(8), np.empty(8)
    n_sides = 0
    for way in range(8):
        a, b = corner[way], corner[(way + 1) % 8]
        if xy[a, 0] != xy[b, 0] or xy[a, 1] != xy[b, 1]:
            ax[n_sides], ay[n_sides] = xy[a, 0], xy[a, 1]
            ex[n_sides], ey[n_sides] = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
            n_sides += 1
    result = np.zeros(len(xy), np.bool_)
    for way in range(8):
        result[corner[way]] = True
    for i in range(len(xy)):
        for side in range(n_sides):
            if ex[side] * (xy[i, 1] - ay[side]) - ey[side] * (xy[i, 0] - ax[side]) <= 0:
                result[i] = True
                break
    return result


@njit(cache=True)
def _hull(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Andrew's monotone chain over points sorted by x, then y."""
    n = len(xy)
    hull = np.empty((2 * n + 1, 2))
    size = 0
    for half in range(2):
        first = size
        for step in range(n):
            p = xy[step] if half == 0 else xy[n - 1 - step]
            while size - first >= 2:
                a, b = hull[size - 2], hull[size - 1]
                if (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0:
                    break
                size -= 1
            if size == first or p[0] != hull[size - 1, 0] or p[1] != hull[size - 1, 1]:
                hull[size, 0], hull[size, 1] = p[0], p[1]
                size += 1
        if size > first + 1 or half == 1:
            size -= 1  # the last corner is the first of the other chain
    return hull[: max(size, 1)].copy()


def polygon_area(corners: NDArray[np.float64]) -> float:
    """Return the area of a polygon."""
    if len(corners) < 3:
        return 0.0
    x, y = (corners - corners[0]).T  # the first and last terms of the sum are 0
    return float(abs(x[:-1] @ y[1:] - y[:-1] @ x[1:]) / 2)


def oriented_box(hull: NDArray[np.float64]) -> Box:
    """Return the rectangle of minimum area around a convex hull; one of its sides lies on a side of the hull."""
    middle = hull.mean(axis=0)
    moved = hull - middle
    sides = np.concatenate([moved[1:], moved[:1]]) - moved
    angle = np.arctan2(sides[:, 1], sides[:, 0])
    along, across = _project(moved, angle)
    spans = along.max(axis=0) - along.min(axis=0), across.max(axis=0) - across.min(axis=0)
    # The perimeter breaks ties between rectangles of (almost) no area.
    best = angle[[np.argmin(spans[0] * spans[1] + 1e-6 * (spans[0] + spans[1]))]]
    along, across = _project(moved, best)
    return _box(middle, float(best[0]), (along.min(), along.max(), across.min(), across.max()))


def _project(xy: NDArray[np.float64], angle: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    c, s = np.cos(angle), np.sin(angle)
    return xy @ np.stack([c, s]), xy @ np.stack([-s, c])


def _box(middle: NDArray[np.float64], angle: float, limits: tuple[float, float, float, float]) -> Box:
    left, right, back, front = (float(value) for value in limits)
    c, s = np.cos(angle), np.sin(angle)
    centre = middle + (left + right) / 2 * np.array([c, s]) + (back + front) / 2 * np.array([-s, c])
    first, second = right - left, front - back
    direction = np.degrees(angle) if first >= second else np.degrees(angle) + 90.0
    return Box(centre, max(first, second), min(first, second), float((90.0 - direction) % 180.0))


def vehicle_box(xy: NDArray[np.float64]) -> Box:
    """Fit a rectangle to a vehicle with one or two visible sides, by the closeness criterion."""
    middle = xy.mean(axis=0)
    moved = xy - middle
    angle = 0.0
    for reach, step, most in _STEPS:
        steps = np.radians(np.arange(-reach, reach, step))
        thinned = np.ascontiguousarray(moved[:: max(len(moved) // most, 1)])
        angle += float(steps[np.argmax(_closeness(thinned, angle + steps))])
    sides = _project(moved, np.array([angle]))
    limits = [trimmed(side, _STRAY) for side in sides]
    longer = int(limits[1][1] - limits[1][0] > limits[0][1] - limits[0][0])
    limits[longer] = trimmed(sides[longer], _STRAY_ENDS)
    return _box(middle, angle, (*limits[0], *limits[1]))


@njit(cache=True)
def _limits(values: NDArray[np.float64], stray: int) -> tuple[float, float]:
    """Return the limits of values after trimming `stray` values at each end."""
    low, high = (
        np.full(stray + 1, np.inf),
        np.full(stray + 1, -np.inf),
    )  # smallest values, ascending, and largest, descending
    for value in values:
        if value < low[stray]:
            k = stray
            while k > 0 and low[k - 1] > value:
                low[k] = low[k - 1]
                k -= 1
            low[k] = value
        if value > high[stray]:
            k = stray
            while k > 0 and high[k - 1] < value:
                high[k] = high[k - 1]
                k -= 1
            high[k] = value
    return low[stray], high[stray]


@njit(cache=True)
def _closeness(xy: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of inverse distances to the nearest side of the trimmed rectangle for each direction."""
    score = np.zeros(len(angles))
    n = len(xy)
    stray = int(_STRAY * n)
    along, across = np.empty(n), np.empty(n)
    for a in range(len(angles)):
        c, s = np.cos(angles[a]), np.sin(angles[a])
        for i in range(n):
            along[i], across[i] = xy[i, 0] * c + xy[i, 1] * s, xy[i, 1] * c - xy[i, 0] * s
        left, right = _limits(along, stray)
        back, front = _limits(across, stray)
        for i in range(n):
            u, v = min(abs(along[i] - left), abs(right - along[i])), min(abs(across[i] - back), abs(front - across[i]))
            score[a] += 1.0 / max(min(u, v), _NEAR_EDGE)
    return score
