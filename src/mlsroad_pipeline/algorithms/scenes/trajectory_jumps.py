"""Positions of a trajectory that no vehicle can have reached."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError

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
