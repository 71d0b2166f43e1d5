"""Sensor and scene statistics that simulated and recorded surveys share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column, check_positive, check_xyz

_RUN = 12  # short steps at the beginning of a scan line
_GROUND_RISE = 0.35  # metres; a larger rise or fall ends the ground of a line
_LONG = 0.1  # metres; differences of longer steps exceed the range noise
_FEWEST = 20  # steps on the ground that a fit needs


@dataclass(frozen=True)
class ScanLines:
    """Scan lines of a side-looking line scanner above even ground, one row per fitted line."""

    first: NDArray[np.int64]  # Row of each line's first point
    height: NDArray[np.float64]  # Height of the scanner above the ground, metres
    step: NDArray[np.float64]  # Angle between neighbouring pulses, degrees
    nadir: NDArray[np.float64]  # Ground below the scanner, metres
    reach: NDArray[np.float64]  # Distance from the nadir to the last point on the ground, metres
    direction: NDArray[np.float64]  # Unit vector in plan from the nadir along the line


def fit_scan_lines(xyz: ArrayLike, *, min_jump: float = 1.0, max_step: float = 0.08) -> ScanLines:
    """Fit the scan lines of a side-looking line scanner to points in the order measured.

    On even ground a pulse at the angle a from the nadir hits the ground at r = h tan a.
    """
    check_positive(min_jump, "min_jump")
    check_positive(max_step, "max_step")
    points = check_xyz(xyz).astype(np.float64)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(steps) <= _RUN:
        return _as_lines([])
    longest = np.lib.stride_tricks.sliding_window_view(steps, _RUN).max(axis=1)  # of the steps i to i + _RUN
    begins = np.r_[True, steps[: len(longest) - 1] > min_jump] & (longest < max_step)
    first = np.flatnonzero(begins)
    fitted = (_fit_line(points[a:b], int(a)) for a, b in zip(first, np.append(first[1:], len(points)), strict=True))
    return _as_lines([line for line in fitted if line is not None])


_Line = tuple[int, float, float, NDArray[np.float64], float, NDArray[np.float64]]


def _fit_line(line: NDArray[np.float64], first: int) -> _Line | None:
    """Fit the parabola of the steps to the ground at the beginning of a line."""
    ends = np.flatnonzero(np.abs(line[:, 2] - line[0, 2]) > _GROUND_RISE)
    ground = line[: ends[0]] if len(ends) else line
    along = ground[-1, :2] - ground[0, :2]
    length = float(np.hypot(*along))
    if len(ground) <= _FEWEST or length < 2.0:
        return None
    along = along / length
    r = (ground[:, :2] - ground[0, :2]) @ along
    step, middle = np.diff(r), (r[1:] + r[:-1]) / 2
    # Steps grow along the ground; an object there shortens one suddenly, and the one before it is cut.
    longest = np.maximum.accumulate(step)
    short = np.flatnonzero((longest > _LONG) & (step < longest / 2))
    good = (step > 0) & (np.arange(len(step)) < (short[0] - 1 if len(short) else len(step)))
    if good.sum() < _FEWEST:
        return None
    a, b, c = np.polyfit(middle[good], step[good], 2, w=1 / (0.01 + 0.1 * step[good]))
    nadir = -b / (2 * a) if a > 0 else 0.0
    least = c - a * nadir**2
    if a <= 0 or least <= 0:
        return None
    below = np.append(ground[0, :2] + nadir * along, ground[0, 2])
    return first, float(np.sqrt(least / a)), float(np.degrees(np.sqrt(a * least))), below, length - nadir, along


def _as_lines(fitted: list[_Line]) -> ScanLines:
    columns = list(zip(*fitted, strict=True)) if fitted else [()] * 6
    return ScanLines(
        np.array(columns[0], np.int64),
        np.array(columns[1], np.float64),
        np.array(columns[2], np.float64),
        np.array(columns[3], np.float64).reshape(-1, 3),
        np.array(columns[4], np.float64),
        np.array(columns[5], np.float64).reshape(-1, 2),
    )


def surface_density(xyz: ArrayLike, *, k: int = 16) -> NDArray[np.float64]:
    """Estimate the points per square metre of surface around each point."""
    check_at_least(k, 1, "k")
    points = check_xyz(xyz)
    if len(points) <= k:
        return np.full(len(points), np.nan)
    distance = cKDTree(points).query(points, k=[k + 1])[0][:, 0]
    with np.errstate(divide="ignore"):
        return np.asarray(k / (np.pi * distance**2))


def plane_residuals(
    xyz: ArrayLike, *, cell_size: float = 0.5, min_points: int = 20
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane to the points of each cell of a grid and return their scatter about it."""
    check_positive(cell_size, "cell_size")
    if min_points < 4:
        raise ParameterError(f"min_points must be at least 4, got {min_points!r}")
    points = check_xyz(xyz).astype(np.float64)
    if len(points) == 0:
        return np.zeros(0), np.zeros((0, 3))
    _, cell = np.unique(np.floor(points / cell_size).astype(np.int64), axis=0, return_inverse=True)
    count = np.bincount(cell)
    centre = np.column_stack([np.bincount(cell, points[:, a]) for a in range(3)]) / count[:, None]
    local = points - centre[cell]
    moments = np.empty((len(count), 3, 3))
    for a in range(3):
        for b in range(3):
            moments[:, a, b] = np.bincount(cell, local[:, a] * local[:, b])
    full = count >= min_points
    smallest = np.linalg.eigvalsh(moments[full])[:, 0]
    return np.sqrt(np.maximum(smallest, 0.0) / (count[full] - 3)), centre[full]


def incidence_angles(xyz: ArrayLike, normals: ArrayLike, origins: ArrayLike) -> NDArray[np.float64]:
    """Return the angles of incidence of beams on surfaces."""
    points = check_xyz(xyz).astype(np.float64)
    directions = points - np.asarray(origins, np.float64)
    vectors = np.asarray(normals, np.float64)
    if vectors.shape != points.shape or directions.shape != points.shape:
        raise DataError(f"normals {vectors.shape} and directions {directions.shape} must have shape {points.shape}")
    with np.errstate(invalid="ignore"):
        cosine = np.abs((directions * vectors).sum(axis=1)) / np.linalg.norm(directions, axis=1)
    return np.asarray(np.degrees(np.arccos(np.minimum(cosine, 1.0))))


def binned_quantiles(
    values: ArrayLike, at: ArrayLike, edges: ArrayLike, *, shares: tuple[float, ...] = (0.25, 0.5, 0.75)
) -> NDArray[np.float64]:
    """Return quantiles of values in bins of another quantity."""
    where = np.asarray(at, np.float64)
    numbers = check_column(values, len(where), "values").astype(np.float64)
    borders = np.asarray(edges, np.float64)
    if len(borders) < 2 or not (np.diff(borders) > 0).all():
        raise ParameterError(f"edges must be at least two rising numbers, got {edges!r}")
    numbers, where = numbers[np.isfinite(numbers)], where[np.isfinite(numbers)]
    number = np.searchsorted(borders, where, side="right") - 1
    out = np.full((len(borders) - 1, len(shares)), np.nan)
    for b in range(len(out)):
        inside = numbers[number == b]
        if len(inside):
            out[b] = np.quantile(inside, shares)
    return out


def distribution_gap(first: ArrayLike, second: ArrayLike) -> float:
    """Return the Kolmogorov-Smirnov statistic: the largest difference of two distribution functions."""
    a, b = (np.sort(v[np.isfinite(v)]) for v in (np.asarray(first, np.float64), np.asarray(second, np.float64)))
    if len(a) == 0 or len(b) == 0:
        return float("nan")
    every = np.concatenate([a, b])
    below_a, below_b = (np.searchsorted(v, every, side="right") / len(v) for v in (a, b))
    return float(np.abs(below_a - below_b).max())
