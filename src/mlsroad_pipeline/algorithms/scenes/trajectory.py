"""Trajectory of the survey vehicle, its jumps, and stations along it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.geometry import polyline

FASTEST = 100.0
"""Highest speed of a survey vehicle, m/s. Faster movements are errors of the record."""

SLACK = 20.0
"""Error of a position that is allowed on top of this speed, m."""

TIMED, UNTIMED = 20.0, 100.0
"""Multiples of the median step that are never a jump, with and without times; the latter is also a number of metres."""

FAR_END = 20.0
"""Multiple of this step from which the first or last position without times is an error and no long straight."""

MOST_DROPPED = 0.01
"""Share of positions that may be left out; with more, the record is an error."""


def without_jumps(
    xyz: NDArray[np.float64], time: NDArray[np.float64] | None, rows: NDArray[np.integer], source: str
) -> tuple[NDArray[np.bool_], str]:
    """Find single positions far from those before and after them.

    Parts between jumps are joined to the longest one where a vehicle can have driven the gap. A few positions that
    cannot be joined are left out.
    """
    keep = np.ones(len(xyz), dtype=bool)
    if len(xyz) < 3:
        return keep, ""
    xy = np.clip(xyz[:, :2], -1e150, 1e150)  # squares of larger numbers overflow
    with np.errstate(invalid="ignore"):
        steps = np.hypot(*np.diff(xy, axis=0).T)
    usual = float(np.median(steps))

    def longest(seconds: NDArray[np.float64] | float) -> NDArray[np.float64]:
        if time is None:
            return np.asarray(UNTIMED * max(1.0, usual))
        return np.maximum(FASTEST * np.asarray(seconds) + SLACK, TIMED * usual)

    clock = np.zeros(len(xyz)) if time is None else time
    starts = np.concatenate([[0], np.flatnonzero(steps > longest(np.diff(clock))) + 1, [len(xyz)]])
    if len(starts) == 2:
        return keep, ""
    reached = _reached(xy, clock, starts, longest)
    lengths = np.diff(starts)
    most = max(1, int(MOST_DROPPED * len(xyz)))

    step = float(longest(0.0))
    dropped = [
        i
        for i in np.flatnonzero(~reached).tolist()
        if time is not None or (lengths[i] <= most and _is_stray(xy, steps, starts, i, step))
    ]
    count = int(lengths[dropped].sum())
    if not dropped:
        return keep, ""
    first = int(starts[dropped[0]])
    where = f"row {int(rows[first])} is at {xyz[first, 0]:.6g}, {xyz[first, 1]:.6g}"
    if count > most:
        raise DataError(f"{source}: {count} of {len(xyz)} positions cannot be reached from the others: {where}")
    for i in dropped:
        keep[starts[i] : starts[i + 1]] = False
    what = "1 position that no vehicle can reach was" if count == 1 else f"{count} positions out of reach were"
    return keep, f"{what} left out of the trajectory: {where}"


def _is_stray(
    xy: NDArray[np.float64], steps: NDArray[np.float64], starts: NDArray[np.int64], part: int, longest: float
) -> bool:
    """Return whether the path goes on without a part; the far ends of a path without times are strays."""
    if part in (0, len(starts) - 2):
        beside = steps[starts[1] - 1] if part == 0 else steps[starts[part] - 1]
        return bool(beside > FAR_END * longest)
    return bool(np.hypot(*(xy[starts[part + 1]] - xy[starts[part] - 1])) <= longest)


def _reached(
    xy: NDArray[np.float64],
    clock: NDArray[np.float64],
    starts: NDArray[np.int64],
    longest: Callable[[float], NDArray[np.float64]],
) -> NDArray[np.bool_]:
    """Return which parts can be driven from the longest one, directly or through others."""
    lengths = np.diff(starts)
    reached = np.zeros(len(lengths), dtype=bool)
    middle = int(lengths.argmax())
    reached[middle] = True

    def near(end: int, start: int) -> bool:
        return bool(np.hypot(*(xy[start] - xy[end])) <= longest(float(clock[start] - clock[end])))

    last = middle
    for i in range(middle + 1, len(lengths)):
        if near(int(starts[last + 1]) - 1, int(starts[i])):
            reached[i], last = True, i
    first = middle
    for i in range(middle - 1, -1, -1):
        if near(int(starts[i + 1]) - 1, int(starts[first])):
            reached[i], first = True, i
    return reached


_CHUNK = 1 << 20


@dataclass(frozen=True)
class Trajectory:
    """Trajectory of the survey vehicle in world coordinates. `from_positions` builds it from recorded positions.

    Parameters
    ----------
    time : ndarray of float64, shape (m,), or None
        Seconds, strictly increasing; None for positions without times.
    xyz : ndarray of float64, shape (m, 3)
        World coordinates, metres, in the order of travel.
    station : ndarray of float64, shape (m,)
        Station: length travelled in plan, metres; 0 at the first position, constant while the vehicle stands still.
    source : str
        Name in messages, usually the path of the file.
    note : str
        Sentence on positions that were left out; empty if none was.
    """

    time: NDArray[np.float64] | None
    xyz: NDArray[np.float64]
    station: NDArray[np.float64]
    source: str = field(default="trajectory", compare=False)
    note: str = field(default="", compare=False)

    @classmethod
    def from_positions(
        cls,
        xyz: ArrayLike,
        time: ArrayLike | None = None,
        *,
        minimum_step: float = 0.01,
        source: str = "trajectory",
        check_jumps: bool = True,
    ) -> Trajectory:
        """Build a trajectory from recorded positions.

        Positions are sorted by time; the first of several positions with the same time is kept. Movements of less than
        `minimum_step` in plan since the last kept position do not increase the station, so that the jitter of a
        standing vehicle adds no length. Single positions that no vehicle can have reached are left out (`note`).

        Parameters
        ----------
        xyz : array-like of shape (m, 3)
            World coordinates, metres; without `time` in the order of travel.
        time : array-like of shape (m,), optional
            Seconds, in any order.
        minimum_step : float, default 0.01
            Smallest movement, metres. Larger values suppress more jitter and cut corners by up to this distance.
        source : str, default "trajectory"
            Name in messages, usually the path of the file.
        check_jumps : bool, default True
            Whether positions that no vehicle can have reached are left out; False for lines that have been checked.

        Returns
        -------
        Trajectory
            Time, positions and stations.

        Raises
        ------
        DataError
            If `xyz` is not (m, 3), a coordinate or time is NaN or infinite, the lengths differ, more than one position
            in a hundred cannot be reached from the others, or fewer than two positions are `minimum_step` apart.
        """
        positions = check_xyz(xyz, name=f"{source}: positions").astype(np.float64)
        seconds, rows = None, np.arange(len(positions))
        if time is not None:
            seconds = check_column(time, len(positions), f"{source}: time").astype(np.float64)
            if not np.isfinite(seconds).all():
                row = int(np.flatnonzero(~np.isfinite(seconds))[0])
                raise DataError(f"{source}: time at row {row} is {seconds[row]}")
            seconds, rows = np.unique(seconds, return_index=True)
            positions = positions[rows]
        note = ""
        if check_jumps:
            kept, note = without_jumps(positions, seconds, rows, source)
            positions = positions[kept]
            seconds = None if seconds is None else seconds[kept]
        station = _stations(positions[:, :2], minimum_step)
        if len(station) == 0 or station[-1] == 0.0:
            raise DataError(
                f"{source}: the {len(positions)} positions are less than {minimum_step} m apart: there is no movement"
            )
        return cls(seconds, positions, station, source, note)

    @property
    def length(self) -> float:
        """Length in plan, metres."""
        return float(self.station[-1])

    @cached_property
    def _polyline(self) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        moving = np.concatenate([[True], np.diff(self.station) > 0])
        centre = np.floor(self.xyz[:, :2].mean(axis=0))  # squares of UTM coordinates lose the millimetres
        vertices = np.ascontiguousarray(self.xyz[moving, :2] - centre)
        return vertices, self.station[moving], polyline.build_capsules(vertices), centre

    def locate(
        self, xyz: ArrayLike, *, origin: ArrayLike = (0.0, 0.0, 0.0)
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return station and offset of points relative to the trajectory.

        Parameters
        ----------
        xyz : array-like of shape (n, 3)
            Coordinates, metres.
        origin : array-like of shape (3,), default zeros
            World coordinates of the origin of `xyz`, so that local points need no copy in world coordinates.

        Returns
        -------
        station : ndarray of float64, shape (n,)
            Station of the nearest point of the trajectory, metres. The end segments are extended straight: points
            before the first or after the last position have stations below 0 or above `length`.
        offset : ndarray of float64, shape (n,)
            Distance to the nearest point in plan, metres, positive to the right of the direction of travel.

        Raises
        ------
        DataError
            If `xyz` is not (n, 3) or has NaN or infinite coordinates.
        """
        points = check_xyz(xyz)
        vertices, stations, capsules, centre = self._polyline
        shift = np.asarray(origin, dtype=np.float64)[:2] - centre
        station, offset = np.empty(len(points)), np.empty(len(points))
        for first in range(0, len(points), _CHUNK):  # world coordinates of one chunk at a time
            part = slice(first, first + _CHUNK)
            moved = points[part, :2].astype(np.float64) + shift
            station[part], offset[part] = polyline.locate(moved, vertices, stations, capsules)
        return station, offset

    def distance(self, xyz: ArrayLike) -> NDArray[np.float64]:
        """Return the distance of points from the path in plan, metres; unlike the offset, also beyond its ends."""
        station, offset = self.locate(xyz)
        return np.hypot(offset, np.maximum(np.maximum(-station, station - self.length), 0.0))


def _stations(xy: NDArray[np.float64], minimum_step: float) -> NDArray[np.float64]:
    """Return the length travelled over positions at least `minimum_step` from the last kept one."""
    station = np.zeros(len(xy))
    last = 0
    for i in range(1, len(xy)):
        step = float(np.hypot(xy[i, 0] - xy[last, 0], xy[i, 1] - xy[last, 1]))
        moved = step >= minimum_step
        station[i] = station[i - 1] + (step if moved else 0.0)
        last = i if moved else last
    return station
