"""Axes of poles and trunks: a line through the middle of the shaft, and the circle of its cross-section."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

_SLICE = 0.25  # height of the slices whose medians an axis is fitted to, metres
_BAND = 0.06  # how far a slice's median may lie from the axis, metres
_SHAFT = 0.25  # how far the points of a shaft may lie from the first estimate of its axis, metres
_TUKEY = 4.685  # deviations beyond which a slice has no weight: 95 % efficient for normal errors
_LEAST_SPREAD = 0.003  # metres; slices are not trusted better than this

_CIRCLE_TRIALS = 300
_RADIUS = (0.025, 0.75)  # of shafts and trunks, metres
_LEAST_ARC = 9  # of 36 sectors of a circle that must have points
_LEAST_SHARE = 0.5  # of the points near a circle that must lie on it
_LEAST_POINTS = 10
_LARGEST_ERROR = 0.02  # standard error of the radius, metres


@dataclass(frozen=True)
class Axis:
    """The axis of a shaft.

    Parameters
    ----------
    foot : ndarray of float64, shape (2,)
        x and y at z = 0, metres.
    slope : ndarray of float64, shape (2,)
        Change of x and y per metre of z.
    share : float
        Share of the slices of 0.25 m between bottom and top that it passes.
    error : float
        Standard error of the slope, metres per metre.
    """

    foot: NDArray[np.float64]
    slope: NDArray[np.float64]
    share: float
    error: float

    def at(self, z: float) -> NDArray[np.float64]:
        """Return x and y at a height."""
        return self.foot + self.slope * z

    @property
    def tilt(self) -> float:
        """Angle to the vertical, degrees."""
        return float(np.degrees(np.arctan(np.hypot(*self.slope))))

    @property
    def direction(self) -> float:
        """Where it leans, degrees clockwise from north, 0 to 360."""
        return float(np.degrees(np.arctan2(self.slope[0], self.slope[1])) % 360.0)

    def distance(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the horizontal distances of points from it."""
        return np.hypot(*(xyz[:, :2] - self.foot - self.slope * xyz[:, 2:]).T)


def fit_axis(xyz: NDArray[np.float64]) -> Axis | None:
    """Fit the axis of a pole, blind to arms, signs and lamps on it.

    The medians of slices of 0.25 m are taken; of all lines through two of them the one that most are near is kept
    (each counts by one less its squared distance over 0.06 m, nothing beyond that). The medians are then taken anew from the points within 0.25 m of it, and the line is refined on those
    that it passes by least squares with Tukey's weights.

    Parameters
    ----------
    xyz : ndarray of float64, shape (k, 3)
        Points, metres.

    Returns
    -------
    Axis or None
        None with fewer than three slices on a line.
    """
    if len(xyz) < 3:
        return None
    centre = xyz.mean(axis=0)
    local = xyz - centre
    order = np.argsort(local[:, 2], kind="stable")
    found = _fit_line(local[order])
    if found[6] < 3:
        return None
    slope = found[2:4].copy()
    foot = found[:2] + centre[:2] - slope * centre[2]
    return Axis(foot, slope, share=float(found[6] / found[5]), error=float(found[4]))


@njit(cache=True)
def _medians(xyz: NDArray[np.float64], line: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Return the median points of slices, from points within reach of a line (x0, y0, dx, dy); z ascending."""
    low = xyz[0, 2]
    result = np.empty((int((xyz[-1, 2] - low) / _SLICE) + 1, 3))
    chosen = np.empty((len(xyz), 3))
    count, slices, current = 0, 0, 0
    for i in range(len(xyz) + 1):
        number = int((xyz[i, 2] - low) / _SLICE) if i < len(xyz) else -1
        if number != current:
            if count:
                for axis in range(3):
                    result[slices, axis] = np.median(chosen[:count, axis])
                slices += 1
            count, current = 0, number
        if i < len(xyz):
            x, y = line[0] + line[2] * xyz[i, 2], line[1] + line[3] * xyz[i, 2]
            if np.hypot(xyz[i, 0] - x, xyz[i, 1] - y) <= reach:
                chosen[count] = xyz[i]
                count += 1
    return result[:slices]


@njit(cache=True)
def _passing(medians: NDArray[np.float64], line: NDArray[np.float64]) -> NDArray[np.float64]:
    away = np.empty(len(medians))
    for i in range(len(medians)):
        z = medians[i, 2]
        away[i] = np.hypot(medians[i, 0] - line[0] - line[2] * z, medians[i, 1] - line[1] - line[3] * z)
    return away


@njit(cache=True)
def _best_pair(medians: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the line through two medians that most pass near: each counts by 1 - (distance / band)^2."""
    best = np.zeros(4)
    most = 0.0
    for a in range(len(medians)):
        for b in range(a + 1, len(medians)):
            rise = medians[b, 2] - medians[a, 2]
            if rise < 0.5 * _SLICE:
                continue
            dx, dy = (medians[b, 0] - medians[a, 0]) / rise, (medians[b, 1] - medians[a, 1]) / rise
            x, y = medians[a, 0] - dx * medians[a, 2], medians[a, 1] - dy * medians[a, 2]
            total = 0.0
            for i in range(len(medians)):
                z = medians[i, 2]
                square = (medians[i, 0] - x - dx * z) ** 2 + (medians[i, 1] - y - dy * z) ** 2
                total += max(0.0, 1.0 - square / _BAND**2)
            if total > most:
                most = total
                best[:] = x, y, dx, dy
    return best


@njit(cache=True)
def _weighted_line(medians: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x0, y0, dx, dy and the standard error of dx and dy."""
    total = weight.sum()
    middle = np.zeros(3)
    for axis in range(3):
        middle[axis] = (weight * medians[:, axis]).sum() / total
    z = medians[:, 2] - middle[2]
    spread = (weight * z * z).sum()
    result = np.zeros(5)
    for axis in range(2):
        slope = (weight * z * (medians[:, axis] - middle[axis])).sum() / spread
        result[axis], result[2 + axis] = middle[axis] - slope * middle[2], slope
    away = _passing(medians, result)
    result[4] = np.sqrt((weight * away * away).sum() / 2 / max(total - 2.0, 1.0) / spread)
    return result


@njit(cache=True)
def _fit_line(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x0, y0, dx, dy, the slope's error, the number of slices and how many of them lie on the line."""
    result = np.zeros(7)
    whole = _medians(xyz, np.zeros(4), np.inf)
    result[5] = int((xyz[-1, 2] - xyz[0, 2]) / _SLICE) + 1
    if len(whole) < 3:
        return result
    medians = _medians(xyz, _best_pair(whole), _SHAFT)
    line = _best_pair(medians)
    away = _passing(medians, line)
    chosen = medians[away <= _BAND]
    result[6] = len(chosen)
    if len(chosen) < 3:
        return result
    weight = np.ones(len(chosen))
    for _ in range(5):
        fitted = _weighted_line(chosen, weight)
        away = _passing(chosen, fitted)
        scale = _TUKEY * max(1.4826 * np.median(away), _LEAST_SPREAD)
        weight = np.maximum(1.0 - (away / scale) ** 2, 0.0) ** 2
        if (weight > 0).sum() < 3:
            break
    result[:5] = fitted
    return result


@dataclass(frozen=True)
class Circle:
    """The cross-section of a shaft.

    Parameters
    ----------
    centre : ndarray of float64, shape (2,)
        Its middle, metres.
    diameter : float
        Metres.
    arc : float
        Share of the circle that has points.
    """

    centre: NDArray[np.float64]
    diameter: float
    arc: float


def fit_circle(xy: NDArray[np.float64], *, reach: float, band: float = 0.015) -> Circle | None:
    """Fit the circle of a round shaft to points projected along its axis.

    Of the circles through three points the one that passes within `band` of most, compared with those inside of it and
    just outside, is refined by geometric least squares. 300 triples are drawn from a fixed sequence.

    Parameters
    ----------
    xy : ndarray of float64, shape (k, 2)
        Points, metres, relative to the expected centre.
    reach : float
        How far the centre may lie from the expected one, metres.
    band : float, default 0.015
        How far a point may lie from the circle, metres: more for bark than for steel.

    Returns
    -------
    Circle or None
        None where the points do not show one: fewer than ten on it, or than half of those inside and just outside, less
        than a quarter of the way around, or a radius that is not known to 2 cm.
    """
    if len(xy) < _LEAST_POINTS:
        return None
    found = _circle(np.ascontiguousarray(xy), reach, band)
    if found[3] < _LEAST_POINTS or found[4] < _LEAST_ARC or found[5] < _LEAST_SHARE or found[6] > _LARGEST_ERROR:
        return None
    return Circle(found[:2].copy(), float(2 * found[2]), float(found[4] / 36))


@njit(cache=True)
def _score(xy: NDArray[np.float64], x: float, y: float, radius: float, band: float) -> tuple[int, int]:
    """Count the points on a circle, and those inside it or within 5 cm outside."""
    on, near = 0, 0
    for i in range(len(xy)):
        away = np.hypot(xy[i, 0] - x, xy[i, 1] - y) - radius
        on += abs(away) <= band
        near += away <= 0.05
    return on, near


@njit(cache=True)
def _through(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return centre and radius of the circle through three points; a radius of 0 where they lie on a line."""
    bx, by, cx, cy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
    twice = 2 * (bx * cy - by * cx)
    if abs(twice) < 1e-9:
        return 0.0, 0.0, 0.0
    bb, cc = bx * bx + by * by, cx * cx + cy * cy
    x, y = (cy * bb - by * cc) / twice, (bx * cc - cx * bb) / twice
    return a[0] + x, a[1] + y, np.hypot(x, y)


@njit(cache=True)
def _circle(xy: NDArray[np.float64], reach: float, band: float) -> NDArray[np.float64]:
    """Return centre, radius, points on it, sectors of 36, share of the points near it, standard error of the radius."""
    result = np.zeros(7)
    n = len(xy)
    state = np.uint64(88172645463325252)
    best = -1.0
    for _ in range(_CIRCLE_TRIALS):
        pick = np.empty(3, np.int64)
        for k in range(3):  # xorshift: the same triples in every run
            state ^= state << np.uint64(13)
            state ^= state >> np.uint64(7)
            state ^= state << np.uint64(17)
            pick[k] = int(state % np.uint64(n))
        x, y, radius = _through(xy[pick[0]], xy[pick[1]], xy[pick[2]])
        if not _RADIUS[0] <= radius <= _RADIUS[1] or np.hypot(x, y) > reach:
            continue
        on, near = _score(xy, x, y, radius, band)
        if on - 0.5 * (near - on) > best:
            best = on - 0.5 * (near - on)
            result[:3] = x, y, radius
    if best < 0:
        return result
    error = 1.0
    for _ in range(10):
        normal, right, square = np.zeros((3, 3)), np.zeros(3), 0.0
        for i in range(n):
            dx, dy = xy[i, 0] - result[0], xy[i, 1] - result[1]
            far = np.hypot(dx, dy)
            residual = far - result[2]
            if abs(residual) > band or far == 0:
                continue
            row = np.array([dx / far, dy / far, 1.0])
            normal += np.outer(row, row)
            right += row * residual
            square += residual * residual
        if abs(np.linalg.det(normal)) < 1e-9:
            return np.zeros(7)
        inverse = np.linalg.inv(normal)
        result[:3] += inverse @ right
        error = np.sqrt(max(square, 1e-6 * normal[2, 2]) / max(normal[2, 2] - 3.0, 1.0) * inverse[2, 2])
    on, near = _score(xy, result[0], result[1], result[2], band)
    sectors = np.zeros(36, np.bool_)
    for i in range(n):
        dx, dy = xy[i, 0] - result[0], xy[i, 1] - result[1]
        if abs(np.hypot(dx, dy) - result[2]) <= band:
            sectors[int((np.arctan2(dy, dx) + np.pi) / (2 * np.pi) * 36) % 36] = True
    if not _RADIUS[0] <= result[2] <= _RADIUS[1] or np.hypot(result[0], result[1]) > reach:
        return np.zeros(7)
    result[3], result[4], result[5], result[6] = on, sectors.sum(), on / max(near, 1), error
    return result
