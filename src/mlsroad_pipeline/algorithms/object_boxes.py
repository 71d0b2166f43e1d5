"""Objects in plan: their convex hull, the rectangle of least area around it, and the box of a vehicle."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_NEAR_EDGE = 0.05  # distances to an edge below this count alike, metres: d0 of Zhang et al. 2017, algorithm 4
_STRAY = 0.002  # share of points that may lie outside on each side: aerials, mirrors, mixed pixels


def convex_hull(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the convex hull of points in plan.

    Parameters
    ----------
    xy : ndarray of float64, shape (k, 2)
        Points, metres; at least one.

    Returns
    -------
    ndarray of float64, shape (h, 2)
        Its corners, counterclockwise, without points on its sides; fewer than three where all points lie on a line.
    """
    order = np.lexsort((xy[:, 1], xy[:, 0]))
    return _hull(xy[order])


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
                hull[size] = p
                size += 1
        if size > first + 1 or half == 1:
            size -= 1  # the last corner is the first of the other half
    return hull[: max(size, 1)].copy()


def polygon_area(corners: NDArray[np.float64]) -> float:
    """Return the area of a polygon.

    Parameters
    ----------
    corners : ndarray of float64, shape (h, 2)
        Its corners in order, metres.

    Returns
    -------
    float
        Square metres; 0 with fewer than three corners.
    """
    if len(corners) < 3:
        return 0.0
    x, y = (corners - corners[0]).T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def oriented_box(hull: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, float, float]:
    """Find the rectangle of least area around a convex hull; one of its sides lies on a side of the hull.

    Parameters
    ----------
    hull : ndarray of float64, shape (h, 2)
        Corners, as `convex_hull` gives them, metres.

    Returns
    -------
    centre : ndarray of float64, shape (2,)
        Centre of the rectangle.
    length, width : float
        Its longer and its shorter side, metres.
    azimuth : float
        Direction of the longer side, degrees clockwise from north, 0 to 180.
    """
    middle = hull.mean(axis=0)
    moved = hull - middle
    sides = np.roll(moved, -1, axis=0) - moved
    angle = np.arctan2(sides[:, 1], sides[:, 0])
    along, across = _project(moved, angle)
    spans = np.ptp(along, axis=0), np.ptp(across, axis=0)
    # A line has no area at its own direction only: the perimeter decides among equally thin ones.
    best = angle[[np.argmin(spans[0] * spans[1] + 1e-6 * (spans[0] + spans[1]))]]
    along, across = _project(moved, best)
    return _box(middle, float(best[0]), (along.min(), along.max(), across.min(), across.max()))


def _project(xy: NDArray[np.float64], angle: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    c, s = np.cos(angle), np.sin(angle)
    return xy @ np.stack([c, s]), xy @ np.stack([-s, c])


def _box(
    middle: NDArray[np.float64], angle: float, limits: tuple[float, float, float, float]
) -> tuple[NDArray[np.float64], float, float, float]:
    left, right, back, front = (float(value) for value in limits)
    c, s = np.cos(angle), np.sin(angle)
    centre = middle + (left + right) / 2 * np.array([c, s]) + (back + front) / 2 * np.array([-s, c])
    first, second = right - left, front - back
    direction = np.degrees(angle) if first >= second else np.degrees(angle) + 90.0
    return centre, max(first, second), min(first, second), float((90.0 - direction) % 180.0)


def vehicle_box(
    xy: NDArray[np.float64], weight: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], float, float, float]:
    """Fit a rectangle to a vehicle of which one or two sides were seen, by the closeness criterion.

    Of all directions the one whose rectangle has the points nearest to its sides is taken: the sum of the inverse
    distances is largest (Zhang, Xu, Dong and Dolan 2017, "Efficient L-shape fitting for vehicle detection using laser
    scanners", algorithms 2 and 4), with steps of a degree and then of a twentieth. Sides are moved in until one point
    in five hundred lies outside each, so that aerials and mixed pixels do not stretch the box.

    Parameters
    ----------
    xy : ndarray of float64, shape (k, 2)
        Points of its body, metres; at least one.
    weight : ndarray of float64, shape (k,), optional
        Weight of each point in the criterion.

    Returns
    -------
    centre : ndarray of float64, shape (2,)
        Centre of the rectangle.
    length, width : float
        Its longer and its shorter side, metres.
    azimuth : float
        Direction of the longer side, degrees clockwise from north, 0 to 180.
    """
    middle = xy.mean(axis=0)
    moved = xy - middle
    given = np.ones(len(xy)) if weight is None else np.ascontiguousarray(weight, dtype=np.float64)
    coarse = np.radians(np.arange(0.0, 90.0, 1.0))
    angle = coarse[np.argmax(_closeness(moved, given, coarse))]
    fine = angle + np.radians(np.arange(-1.0, 1.01, 0.05))
    angle = fine[np.argmax(_closeness(moved, given, fine))]
    along, across = _project(moved, np.array([angle]))
    share = [_STRAY, 1 - _STRAY]
    limits = (*np.quantile(along, share), *np.quantile(across, share))
    return _box(middle, float(angle), limits)


@njit(cache=True)
def _closeness(
    xy: NDArray[np.float64], weight: NDArray[np.float64], angles: NDArray[np.float64]
) -> NDArray[np.float64]:
    score = np.zeros(len(angles))
    n = len(xy)
    along, across = np.empty(n), np.empty(n)
    for a in range(len(angles)):
        c, s = np.cos(angles[a]), np.sin(angles[a])
        left, right, back, front = np.inf, -np.inf, np.inf, -np.inf
        for i in range(n):
            u, v = xy[i, 0] * c + xy[i, 1] * s, xy[i, 1] * c - xy[i, 0] * s
            along[i], across[i] = u, v
            left, right, back, front = min(left, u), max(right, u), min(back, v), max(front, v)
        total = 0.0
        for i in range(n):
            d = min(along[i] - left, right - along[i], across[i] - back, front - across[i])
            total += weight[i] / max(d, _NEAR_EDGE)
        score[a] = total
    return score
