"""Axes of poles and posts, and circles through their cross-sections."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.sorting import median_of

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
            best_circle[0], best_circle[1], best_circle[2] = x, y, radius
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
        # The inverse of the normal equations by cofactors; they are symmetric.
        cxx, cxy, cyy = nyy * count - ny * ny, nx * ny - nxy * count, nxx * count - nx * nx
        cx, cy, c = nxy * ny - nyy * nx, nxy * nx - nxx * ny, nxx * nyy - nxy * nxy
        determinant = nxx * cxx + nxy * cxy + nx * cx
        if abs(determinant) < 1e-9:
            return -1.0
        circle[0] += (cxx * rx + cxy * ry + cx * r) / determinant
        circle[1] += (cxy * rx + cyy * ry + cy * r) / determinant
        circle[2] += (cx * rx + cy * ry + c * r) / determinant
        error = np.sqrt(max(square, 1e-6 * count) / max(count - 3.0, 1.0) * c / determinant)
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
    occupied = 0
    for sector in range(_SECTORS):
        occupied += sectors[sector]
    result[0], result[1], result[2], result[3] = x, y, radius, on
    result[4], result[5], result[6] = occupied, on / max(near, 1), error
    return result


_SLICE = 0.25  # height of the slices for the medians, metres
_BAND = 0.06  # largest distance of a median from the axis, metres
_SHAFT = 0.25  # largest distance of points of a shaft from the first estimate of its axis, metres
_TUKEY = 4.685  # constant of the biweight: 95 % efficiency for normal errors
_LEAST_SPREAD = 0.003  # lower bound of the deviation of medians, metres


@dataclass(frozen=True)
class Axis:
    """Axis of a shaft."""

    foot: NDArray[np.float64]  # m, x and y at z = 0
    slope: NDArray[np.float64]  # change of x and y per metre of z
    share: float  # of the slices of 0.25 m between bottom and top whose median lies on the axis
    error: float  # m per m, standard error of the slope

    def at(self, z: float) -> NDArray[np.float64]:
        """Return x and y at a height."""
        return self.foot + self.slope * z

    @property
    def tilt(self) -> float:
        """Angle to the vertical, degrees."""
        return float(np.degrees(np.arctan(np.hypot(*self.slope))))

    @property
    def direction(self) -> float:
        """Direction of lean, degrees clockwise from north, 0 to 360."""
        return float(np.degrees(np.arctan2(self.slope[0], self.slope[1])) % 360.0)

    def distance(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the horizontal distances of points from the axis."""
        return np.hypot(*(xyz[:, :2] - self.foot - self.slope * xyz[:, 2:]).T)


def fit_axis(xyz: NDArray[np.float64]) -> Axis | None:
    """Fit the axis of a pole, robust to arms, signs and lamps; None with fewer than three medians on a line.

    Of all lines through two medians of slices of 0.25 m, the best supported one is selected; medians of the points near
    it are fitted by least squares with Tukey's biweight.
    """
    if len(xyz) < 3:
        return None
    centre = xyz.mean(axis=0)
    local = xyz - centre
    order = np.argsort(local[:, 2], kind="stable")
    line = _fit_line(local[order])
    if line[6] < 3:
        return None
    slope = line[2:4].copy()
    foot = line[:2] + centre[:2] - slope * centre[2]
    return Axis(foot, slope, share=float(line[6] / line[5]), error=float(line[4]))


@njit(cache=True)
def _medians(xyz: NDArray[np.float64], line: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Return the median points of slices, from points within reach of a line (x0, y0, dx, dy); z ascending."""
    low = xyz[0, 2]
    result = np.empty((int((xyz[-1, 2] - low) / _SLICE) + 1, 3))
    chosen = np.empty((3, len(xyz)))
    count, slices, current = 0, 0, 0
    for i in range(len(xyz) + 1):
        number = int((xyz[i, 2] - low) / _SLICE) if i < len(xyz) else -1
        if number != current:
            if count:
                for axis in range(3):
                    result[slices, axis] = median_of(chosen[axis], count)
                slices += 1
            count, current = 0, number
        if i < len(xyz):
            x, y = line[0] + line[2] * xyz[i, 2], line[1] + line[3] * xyz[i, 2]
            if np.hypot(xyz[i, 0] - x, xyz[i, 1] - y) <= reach:
                for axis in range(3):
                    chosen[axis, count] = xyz[i, axis]
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
    """Return the line through two medians with the largest sum of max(0, 1 - (distance / band)^2)."""
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
                best[0], best[1], best[2], best[3] = x, y, dx, dy
    return best


@njit(cache=True)
def _weighted_line(medians: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x0, y0, dx, dy and the standard error of dx and dy."""
    total, middle = 0.0, np.zeros(3)
    for i in range(len(weight)):
        total += weight[i]
        for axis in range(3):
            middle[axis] += weight[i] * medians[i, axis]
    for axis in range(3):
        middle[axis] /= total
    spread, products = 0.0, np.zeros(2)
    for i in range(len(weight)):
        z = medians[i, 2] - middle[2]
        spread += weight[i] * z * z
        for axis in range(2):
            products[axis] += weight[i] * z * (medians[i, axis] - middle[axis])
    result = np.zeros(5)
    for axis in range(2):
        slope = products[axis] / spread
        result[axis], result[2 + axis] = middle[axis] - slope * middle[2], slope
    away, squares = _passing(medians, result), 0.0
    for i in range(len(weight)):
        squares += weight[i] * away[i] * away[i]
    result[4] = np.sqrt(squares / 2 / max(total - 2.0, 1.0) / spread)
    return result


@njit(cache=True)
def _fit_line(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x0, y0, dx, dy, the error of the slope, the number of slices and of medians on the line."""
    result = np.zeros(7)
    whole = _medians(xyz, np.zeros(4), np.inf)
    result[5] = int((xyz[-1, 2] - xyz[0, 2]) / _SLICE) + 1
    if len(whole) < 3:
        return result
    medians = _medians(xyz, _best_pair(whole), _SHAFT)
    line = _best_pair(medians)
    away = _passing(medians, line)
    chosen, n = np.empty((len(medians), 3)), 0
    for i in range(len(medians)):
        if away[i] <= _BAND:
            for axis in range(3):
                chosen[n, axis] = medians[i, axis]
            n += 1
    result[6] = n
    if n < 3:
        return result
    chosen, weight = chosen[:n], np.ones(n)
    for _ in range(5):
        fitted = _weighted_line(chosen, weight)
        for k in range(5):
            result[k] = fitted[k]
        away = _passing(chosen, fitted)
        scale = _TUKEY * max(1.4826 * median_of(away.copy(), n), _LEAST_SPREAD)
        n_weights = 0
        for i in range(n):
            weight[i] = max(1.0 - (away[i] / scale) ** 2, 0.0) ** 2
            n_weights += weight[i] > 0
        if n_weights < 3:
            break
    return result
