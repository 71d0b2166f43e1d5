"""Bases of GPS times: seconds of the week, seconds since 1980, and these less 1e9 (adjusted standard GPS time)."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

WEEK = 604_800.0
"""Seconds of a GPS week."""

ADJUSTED = 1e9
"""Seconds by which adjusted standard GPS time is less than GPS time."""

NEAR_END = 600.0
"""Largest distance of the first and last times from the ends of a week whose end a recording contains, seconds."""

LEAP_SECONDS = (18.0, 17.0, 16.0, 15.0, 14.0, 13.0)
"""GPS time less UTC since 1999, the present value first."""
_LEAP_DAYS = ("2017-01-01", "2015-07-01", "2012-07-01", "2009-01-01", "2006-01-01", "1999-01-01")


_EPOCH = np.datetime64("1980-01-06", "s")
_LEAST_GPS, _LARGEST_GPS = 8e8, 1.5e9  # of seconds since 1980: 2005 and 2027; smaller ones are adjusted


def dates_of(time: NDArray[np.float64]) -> NDArray[np.object_]:
    """Return the date of GPS times, ISO 8601; empty without a time and for seconds of the week or of another clock.

    Examples
    --------
    >>> dates_of(np.array([412_345_678.0, 1_412_345_678.0, 200_000.0, np.nan])).tolist()
    ['2024-10-07', '2024-10-07', '', '']
    """
    seconds = since_1980(time)
    known = np.isfinite(seconds)
    days = np.datetime_as_string(
        (_EPOCH + np.where(known, seconds, 0.0).astype("timedelta64[s]")).astype("datetime64[D]")
    )
    return np.where(known, days, "").astype(object)


def since_1980(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return GPS times in seconds since 1980; NaN without a time and for seconds of the week or of another clock."""
    known = np.isfinite(time) & (np.abs(time) > WEEK) & (time < _LARGEST_GPS) & (time > -ADJUSTED)
    return np.where(known, np.where(time < _LEAST_GPS, time + ADJUSTED, time), np.nan)


def utc_of(seconds: float) -> datetime:
    """Return the UTC of seconds since 1980, to milliseconds."""
    date = datetime(1980, 1, 6, tzinfo=UTC) + timedelta(milliseconds=round(1000 * seconds))
    for leap, day in zip(LEAP_SECONDS, _LEAP_DAYS, strict=True):
        if date - timedelta(seconds=leap) >= datetime.fromisoformat(day).replace(tzinfo=UTC):
            break
    return date - timedelta(seconds=leap)


def falls_at_week_end(time: NDArray) -> bool:
    """Return whether seconds of the week fall from 604800 to 0: both ends of a week, and nothing for half of it."""
    if len(time) < 2 or not (time.min() >= 0 and time.max() <= WEEK):
        return False
    if time.min() > NEAR_END or time.max() < WEEK - NEAR_END:
        return False
    ordered = np.unique(time).astype(np.float64)
    return bool(np.diff(ordered).max() > WEEK / 2)


def continued(time: NDArray) -> NDArray:
    """Return times that go on after the end of a week where they fall to 0 there, else the times as they are."""
    return np.where(time < WEEK / 2, time + time.dtype.type(WEEK), time) if falls_at_week_end(time) else time


def base_shift(time: NDArray[np.float64], first: float, last: float) -> float:
    """Return what brings times of one base to the base of an interval, whole weeks and 1e9 s; 0 if nothing does.

    The shift with the longest common time is taken.
    """
    begin, end = float(time[0]), float(time[-1])

    def common(shift: float) -> float:
        return min(end + shift, last) - max(begin + shift, first)

    if common(0.0) >= 0:
        return 0.0
    found = {0.0: 0.0}
    for base in (0.0, ADJUSTED, -ADJUSTED):
        weeks = np.floor((first - begin - base) / WEEK)
        found |= {shift: common(shift) for shift in ((weeks + k) * WEEK + base for k in (0, 1))}
        found[base] = common(base)
    best = max(found, key=lambda shift: found[shift])
    return best if found[best] > 0 else 0.0
