"""Short time windows of a file, for the estimation of the trajectory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.scenes.trajectory_estimation import measured_times
from mlsroad_pipeline.formats.base import PointFormat
from mlsroad_pipeline.formats.options import ReadOptions

WINDOW_LENGTH = 0.1
"""Length of a window, seconds: 20 rotations at 200 lines per second, 4 at 40."""

WINDOW_INTERVAL = 1.0
"""Interval of the windows, seconds; the trajectory is interpolated linearly between them."""

MAX_WINDOWS = 1000
"""Largest number of windows of a file; longer files have a larger interval."""

WINDOW_POINTS = 12_000
"""Largest number of points per window; longer windows are thinned."""


def read_time_windows(
    form: PointFormat, path: str, options: ReadOptions, *, sample: PointCloud, n_points: int
) -> PointCloud | None:
    """Return evenly spaced windows of a file stored in the order of time, or None without times."""
    if "gps_time" not in sample:
        return None
    duration = _duration(sample["gps_time"])
    if duration is None:
        return None
    n_windows = int(np.clip(duration / WINDOW_INTERVAL, 2, MAX_WINDOWS))
    length = int(np.ceil(min(n_points * WINDOW_LENGTH / duration, n_points / n_windows)))
    chosen = replace(options, only=tuple(name for name in ("gps_time", "scanner") if name in sample), coding=None)
    windows = []
    for number, start in enumerate(np.linspace(0, n_points - length, n_windows).astype(int)):
        cloud = form.read(Path(path), chosen, start=int(start), stop=int(start) + length)
        thin = cloud.select(np.arange(0, len(cloud), -(-len(cloud) // WINDOW_POINTS)))
        windows.append(thin.with_columns(window=np.full(len(thin), number, dtype=np.int32)))
    return concatenate(windows)


def _duration(times: NDArray) -> float | None:
    """Return the duration of a file in seconds; single times far from the others do not count."""
    measured = times[measured_times(times)]
    if len(measured) < 2 or not measured.max() > measured.min():
        return None
    low, high = np.percentile(measured, [10, 90])
    most = (high - low) / 0.8
    whole = float(measured.max() - measured.min())
    return whole if whole <= 10 * most or most <= 0 else float(most)
