"""Estimation of the trajectory from points of line scanners with times per pulse.

A line scanner rotates its beam at a constant rate in a plane fixed to the vehicle. In a window of a few rotations the
vehicle moves straight. A point measured at time t is ``p = c + v t + r (A cos wt + B sin wt)`` with centre c, velocity
v, rate w, orthogonal unit vectors A and B and range r. The centre follows from two linear problems. Across the plane,
``n . p = n . c + (n . v) t`` holds for its normal n, the direction of least variance after removal of mean and linear
drift. In the plane, the vector from the centre to a point is parallel to the beam, so their cross product is zero. This
equation is linear and homogeneous in the phase and in phase times centre and velocity; the eigenvector of the smallest
eigenvalue of its normal matrix solves it. Ranges cancel: their noise and mixed pixels have no effect. The normal needs
surfaces other than flat ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

_TURNS = 4  # rotations per window: more average more noise but need straight motion for longer
_MIN_POINTS = 200
_MAX_SPREAD = 0.02  # radians, root mean square angle between beam and point
_MIN_DEPTH = 50.0  # on flat ground a profile is a line, and the plane is undetermined
_RATES = (4.0, 450.0)  # rotations per second of line scanners
LATEST = 1e11  # seconds; larger numbers are no times
_PROBES = 12  # windows for the estimation of the rotation rate

SHARED = 100
"""Largest number of points of a sample that a pulse can have; a time of more points is no measurement."""


def measured_times(times: NDArray) -> NDArray[np.bool_]:
    """Return which times are measurements: finite and, if there are any, not shared by more than `SHARED` points.

    Examples
    --------
    >>> measured_times(np.append(np.arange(3.0), [np.inf, np.nan])).tolist()
    [True, True, True, False, False]
    """
    _, inverse, counts = np.unique(times, return_inverse=True, return_counts=True)
    finite = np.abs(times) < LATEST
    single = finite & (counts[inverse] <= SHARED)
    return single if single.any() else finite


@dataclass(frozen=True)
class _Fit:
    centre: NDArray[np.float64]
    spread: float
    forward: float
    depth: float  # ratio of the smaller variance within the plane to the variance across it

    @property
    def good(self) -> bool:
        return self.spread <= _MAX_SPREAD and self.forward >= 0.9 and self.depth >= _MIN_DEPTH


def _plane(points: NDArray[np.float64], time: NDArray[np.float64]) -> tuple[NDArray, NDArray, float, float]:
    """Return normal, basis (2, 3) and offset of the scan plane at time 0, and the ratio of variances (`_Fit.depth`)."""
    design = np.column_stack([np.ones(len(time)), time / max(float(np.abs(time).max()), 1e-12)])
    drift, *_ = np.linalg.lstsq(design, points, rcond=None)
    rest = points - design @ drift
    values, vectors = np.linalg.eigh(rest.T @ rest)
    normal = vectors[:, 0]
    return normal, vectors[:, 1:].T, float(normal @ drift[0]), float(values[1] / max(values[0], 1e-12))


def _centre(
    xy: NDArray[np.float64], time: NDArray[np.float64], rate: float, sense: float
) -> tuple[NDArray, float, float]:
    """Return the centre at time 0 in the plane, the angular spread, and the share of points on the side of the beam."""
    angle = sense * 2.0 * np.pi * rate * time
    c, s = np.cos(angle), np.sin(angle)
    span = max(float(np.abs(time).max()), 1e-12)
    x, y, t = xy[:, 0], xy[:, 1], time / span
    rows = np.column_stack([x * s - y * c, x * c + y * s, s, c, t * s, t * c])
    weight = np.ones(len(t))
    for _ in range(2):  # the second iteration divides residuals by ranges: angles instead of metres
        weighted = rows * weight[:, None]
        _, vectors = np.linalg.eigh(weighted.T @ weighted)
        a, b, e, f, e_drift, f_drift = vectors[:, 0] / np.hypot(vectors[0, 0], vectors[1, 0])
        centre = np.array([-(a * e + b * f), a * f - b * e])
        drift = np.array([-(a * e_drift + b * f_drift), a * f_drift - b * e_drift])
        away = xy - centre - t[:, None] * drift
        distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 0.5)
        weight = 1.0 / distance
    beam = np.column_stack([a * c - b * s, b * c + a * s])
    across = (away[:, 0] * beam[:, 1] - away[:, 1] * beam[:, 0]) / distance
    ahead = float(np.mean((away * beam).sum(axis=1) > 0))
    return centre, float(np.sqrt(np.mean(across**2))), max(ahead, 1.0 - ahead)


def _fit(points: NDArray[np.float64], time: NDArray[np.float64], rate: float) -> _Fit:
    """Fit a window, with times centred on 0, for the sense of rotation with the smaller spread."""
    middle = points.mean(axis=0)
    normal, basis, offset, depth = _plane(points - middle, time)
    xy = (points - middle) @ basis.T
    fits = [_centre(xy, time, rate, sense) for sense in (1.0, -1.0)]
    centre, spread, ahead = min(fits, key=lambda fit: fit[1])
    return _Fit(centre @ basis + normal * offset + middle, spread, ahead, depth)


def _rate(points: NDArray[np.float64], time: NDArray[np.float64], windows: list[slice]) -> float:
    """Return the rotation rate, from the shortest lag after which points recur at nearly the same place."""
    lags = 1.0 / np.geomspace(_RATES[1], _RATES[0], 1400)
    step = np.median([np.median(np.diff(time[w])) for w in windows])
    base = np.unique(np.concatenate([np.linspace(w.start, w.stop - 1, 150).astype(np.int64) for w in windows]))
    jump = np.full(len(lags), np.inf)
    for i, lag in enumerate(lags):
        later = np.minimum(np.searchsorted(time, time[base] + lag - step / 2), len(time) - 1)
        hit = np.abs(time[later] - time[base] - lag) <= 2 * step
        if hit.sum() >= 50:
            jump[i] = np.median(np.linalg.norm(points[later[hit]] - points[base[hit]], axis=1))
    if not np.isfinite(jump).any():
        raise DataError("the points are too sparse in time to detect rotations of the scanner")
    low = 1.3 * jump.min() + 0.02
    first = int(np.argmax(jump <= low))
    last = first
    while last + 1 < len(lags) and jump[last + 1] <= low:
        last += 1
    return 1.0 / float(lags[first + int(np.argmin(jump[first : last + 1]))])


def _refined(points: NDArray, time: NDArray, middles: NDArray[np.float64], rate: float) -> float:
    from scipy.optimize import minimize_scalar  # noqa: PLC0415  # 0.07 s, which surveys with a trajectory need not wait

    def misfit(trial: float) -> float:
        spreads = [_window_fit(points, time, middle, trial, rate) for middle in middles]
        return float(np.median([fit.spread if fit is not None else np.pi for fit in spreads]))

    trials = rate * (1.0 + np.linspace(-0.012, 0.012, 25))
    start = trials[int(np.argmin([misfit(trial) for trial in trials]))]
    refined = minimize_scalar(
        misfit, bounds=(start * 0.999, start * 1.001), method="bounded", options={"xatol": start * 1e-6}
    )
    return float(refined.x)


def _window_fit(points: NDArray, time: NDArray, middle: float, rate: float, nominal: float) -> _Fit | None:
    half = _TURNS / nominal / 2
    low, high = np.searchsorted(time, [middle - half, middle + half])
    if high - low < _MIN_POINTS:
        return None
    thin = slice(low, high, max(1, (high - low) // 2000))
    return _fit(points[thin], time[thin] - middle, rate)


def _track(
    points: NDArray[np.float64], time: NDArray[np.float64], middles: NDArray[np.float64], rotation_rate: float | None
) -> NDArray[np.float64]:
    """Return the centre of the scanner at given times, NaN where the fit of the window is poor."""
    pulses = np.unique(time)
    if len(pulses) < 0.2 * len(time):
        raise DataError(f"{len(time)} points share {len(pulses)} times: times per pulse are needed")
    edges = np.searchsorted(time, [middles - 0.25, middles + 0.25]).T
    full = [slice(int(a), int(b)) for a, b in edges if b - a >= _MIN_POINTS]
    if not full:
        raise DataError(f"no half second has {_MIN_POINTS} points")
    probes = [full[i] for i in np.unique(np.linspace(0, len(full) - 1, _PROBES).astype(np.int64))]
    nominal = rotation_rate or _rate(points, time, probes)
    centres = np.array([(time[w.start] + time[w.stop - 1]) / 2 for w in probes])
    rate = _refined(points, time, centres, nominal)
    fits = [_window_fit(points, time, middle, rate, nominal) for middle in middles]
    good = [f is not None and f.good for f in fits]
    seen = [f for f in fits if f is not None]
    tried = len(seen)
    if sum(good) < max(2, tried / 2):
        if sum(f.depth < _MIN_DEPTH for f in seen) > tried / 2:
            raise DataError(
                f"in most of {tried} windows the points do not determine one scan plane: flat ground alone, several "
                "scanners without a scanner column, or a multi-beam scanner"
            )
        spread = np.median([f.spread for f in seen]) if tried else np.nan
        raise DataError(
            f"at {rate:.3f} rotations per second only {sum(good)} of {tried} windows fit a beam in a plane "
            f"(spread {spread:.3f} rad): a multi-beam scanner, several scanners without a "
            "scanner column, or changed times"
        )
    return np.array(
        [f.centre if ok and f is not None else np.full(3, np.nan) for f, ok in zip(fits, good, strict=True)]
    )


def estimate_trajectory(
    xyz: ArrayLike,
    gps_time: ArrayLike,
    *,
    scanner: ArrayLike | None = None,
    at: ArrayLike | None = None,
    interval: float = 0.25,
    rotation_rate: float | None = None,
    source: str = "points",
) -> Trajectory:
    """Estimate the trajectory of the survey vehicle from points of line scanners.

    The centre of four rotations is estimated at every `interval` (see the module). Several scanners give the mean of
    their centres.
    """
    points = check_xyz(xyz, name=f"{source}: xyz").astype(np.float64)
    seconds = check_column(gps_time, len(points), f"{source}: gps_time").astype(np.float64)
    check_positive(interval, "interval")
    if rotation_rate is not None:
        check_positive(rotation_rate, "rotation_rate")
    if len(points) == 0 or not np.isfinite(seconds).all():
        raise DataError(
            f"{source}: no trajectory from {len(points)} points, {(~np.isfinite(seconds)).sum()} without time"
        )
    units = np.zeros(len(points), int) if scanner is None else check_column(scanner, len(points), f"{source}: scanner")
    origin = np.floor(points.mean(axis=0))
    start = float(seconds.min())
    if at is None:
        middles = np.arange(interval / 2, seconds.max() - start, interval)
    else:
        middles = np.asarray(at, dtype=np.float64) - start
    tracks = []
    for unit in np.unique(units):
        own = np.flatnonzero(units == unit)
        own = own[np.argsort(seconds[own], kind="stable")]
        try:
            tracks.append(_track(points[own] - origin, seconds[own] - start, middles, rotation_rate))
        except DataError as error:
            raise DataError(f"{source}: no trajectory from scanner {unit}: {error}") from None
    mean = np.mean(tracks, axis=0)  # NaN where a scanner has no centre: the mean of the others is offset from it
    known = np.isfinite(mean).all(axis=1)
    if known.sum() < 2:
        raise DataError(f"{source}: all scanners have a centre at {known.sum()} times only, two are needed")
    return Trajectory.from_positions(mean[known] + origin, middles[known] + start, source=f"{source} (estimated)")


def trajectory_from_windows(windows: Sequence[PointCloud]) -> Trajectory:
    """Estimate the trajectory from short time windows of the files of a survey."""
    windows = [part.select(np.flatnonzero(measured_times(part["gps_time"]))) for part in windows]
    windows = [part for part in windows if len(part)] or list(windows[:1])
    times = np.concatenate([part["gps_time"] for part in windows])
    middles = [
        np.median(part["gps_time"][part["window"] == number])
        for part in windows
        for number in np.unique(part["window"])
    ]
    units = [part.get("scanner") for part in windows]
    known = [unit for unit in units if unit is not None]
    return estimate_trajectory(
        np.concatenate([part.world_xyz() for part in windows]),
        times,
        scanner=np.concatenate(known) if len(known) == len(units) else None,
        at=np.unique(middles),
        source=windows[0].source if len(windows) == 1 else f"{windows[0].source} and {len(windows) - 1} more",
    )
