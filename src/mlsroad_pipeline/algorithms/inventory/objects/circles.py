"""Cross-sections of round shafts and trunks: circle fitting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

_CIRCLE_TRIALS = 200
_CIRCLE_POINTS = 250  # maximum number of points in the search
_RADIUS = (0.025, 0.75)  # of shafts and trunks, metres
_SECTORS, _LEAST_ARC = 18, 5  # sectors of a circle, and minimum number of sectors with points
_LEAST_SHARE = 0.5  # minimum share on the circle of the points near it
_LEAST_POINTS = 10
_LARGEST_ERROR = 0.02  # standard error of the radius, metres


@dataclass(frozen=True)
class Circle:
    """Cross-section of a shaft."""

    centre: NDArray[np.float64]  # m
    diameter: float  # m
    arc: float  # share of the sectors with points


def fit_circle(xy: NDArray[np.float64], *, reach: float, band: float = 0.015) -> Circle | None:
    """Fit the circle of a round shaft to points projected along its axis; None where it is not supported well enough.

    RANSAC over a fixed sequence of 200 triples scores points within `band` of the circle minus half of those inside it
    or within 5 cm outside; geometric least squares refines the best. The centre is within `reach` of (0, 0), metres.
    """
    if len(xy) < _LEAST_POINTS:
        return None
    fit = _circle(np.ascontiguousarray(xy), np.ascontiguousarray(xy[:: len(xy) // _CIRCLE_POINTS + 1]), reach, band)
    if fit[3] < _LEAST_POINTS or fit[4] < _LEAST_ARC or fit[5] < _LEAST_SHARE or fit[6] > _LARGEST_ERROR:
        return None
    return Circle(fit[:2].copy(), float(2 * fit[2]), float(fit[4] / _SECTORS))


@njit(cache=True)
def _score(xy: NDArray[np.float64], x: float, y: float, radius: float, band: float) -> tuple[int, int]:
    """Count the points on a circle, and those inside it or within 5 cm outside."""
    on, near = 0, 0
    inner, outer, limit = max(radius - band, 0.0) ** 2, (radius + band) ** 2, (radius + 0.05) ** 2
    for i in range(len(xy)):
        square = (xy[i, 0] - x) ** 2 + (xy[i, 1] - y) ** 2
        on += inner <= square <= outer
        near += square <= limit
    return on, near


@njit(cache=True)
def _through(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return centre and radius of the circle through three points; a radius of 0 if they are collinear."""
    bx, by, cx, cy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
    twice = 2 * (bx * cy - by * cx)
    if abs(twice) < 1e-9:
        return 0.0, 0.0, 0.0
    bb, cc = bx * bx + by * by, cx * cx + cy * cy
    x, y = (cy * bb - by * cc) / twice, (bx * cc - cx * bb) / twice
    return a[0] + x, a[1] + y, np.hypot(x, y)


@njit(cache=True)
def _best_circle(few: NDArray[np.float64], reach: float, band: float) -> NDArray[np.float64]:
    """Return centre and radius of the best circle through three of the points; a radius of 0 without any."""
    best_circle = np.zeros(3)
    state = np.uint64(88172645463325252)
    best = -1.0
    for _ in range(_CIRCLE_TRIALS):
        pick = np.empty(3, np.int64)
        for k in range(3):  # xorshift: the same triples in every run
            state ^= state << np.uint64(13)
            state ^= state >> np.uint64(7)
            state ^= state << np.uint64(17)
            pick[k] = int(state % np.uint64(len(few)))
        x, y, radius = _through(few[pick[0]], few[pick[1]], few[pick[2]])
        if not _RADIUS[0] <= radius <= _RADIUS[1] or np.hypot(x, y) > reach:
            continue
        on, near = _score(few, x, y, radius, band)
        if on - 0.5 * (near - on) > best:
            best = on - 0.5 * (near - on)
            best_circle[:] = x, y, radius
    return best_circle if best >= 0 else np.zeros(3)


@njit(cache=True)
def _refine_circle(xy: NDArray[np.float64], circle: NDArray[np.float64], band: float) -> float:
    """Refine a circle in place by Gauss-Newton on distances; return the error of its radius, -1 if that fails."""
    error = 1.0
    for _ in range(6):
        nxx, nxy, nyy, nx, ny, rx, ry, r, square, count = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
        for i in range(len(xy)):
            dx, dy = xy[i, 0] - circle[0], xy[i, 1] - circle[1]
            far = np.sqrt(dx * dx + dy * dy)
            residual = far - circle[2]
            if abs(residual) > band or far == 0:
                continue
            dx, dy = dx / far, dy / far
            nxx, nxy, nyy, nx, ny = nxx + dx * dx, nxy + dx * dy, nyy + dy * dy, nx + dx, ny + dy
            rx, ry, r = rx + dx * residual, ry + dy * residual, r + residual
            square, count = square + residual * residual, count + 1
        normal = np.array([[nxx, nxy, nx], [nxy, nyy, ny], [nx, ny, count]])
        if abs(np.linalg.det(normal)) < 1e-9:
            return -1.0
        inverse = np.linalg.inv(normal)
        circle[:] += inverse @ np.array([rx, ry, r])
        error = np.sqrt(max(square, 1e-6 * count) / max(count - 3.0, 1.0) * inverse[2, 2])
    return error


@njit(cache=True)
def _circle(xy: NDArray[np.float64], few: NDArray[np.float64], reach: float, band: float) -> NDArray[np.float64]:
    """Return centre, radius, points on the circle, sectors with points, share of near points on it, radius error."""
    result = np.zeros(7)
    circle = _best_circle(few, reach, band)
    if circle[2] == 0:
        return result
    error = _refine_circle(xy, circle, band)
    x, y, radius = circle[0], circle[1], circle[2]
    if error < 0 or not _RADIUS[0] <= radius <= _RADIUS[1] or np.hypot(x, y) > reach:
        return result
    on, near = _score(xy, x, y, radius, band)
    sectors = np.zeros(_SECTORS, np.bool_)
    for i in range(len(xy)):
        dx, dy = xy[i, 0] - x, xy[i, 1] - y
        if abs(np.hypot(dx, dy) - radius) <= band:
            sectors[int((np.arctan2(dy, dx) + np.pi) / (2 * np.pi) * _SECTORS) % _SECTORS] = True
    result[:3] = circle
    result[3], result[4], result[5], result[6] = on, sectors.sum(), on / max(near, 1), error
    return result
