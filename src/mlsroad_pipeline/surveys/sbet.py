"""Reader of SBET trajectories (Applanix): records of 17 float64 values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.formats.crs import reproject

FIELDS = 17
RECORD = 8 * FIELDS
WGS84 = "EPSG:4979"
WEEK = 604_800.0
PROBED = 64
NEAR = 100.0
"""Largest distance in metres between a trajectory and the extent of its points without a warning."""


def is_sbet(path: Path) -> bool:
    """Return whether a file holds SBET records: plausible times, and latitudes and longitudes in radians."""
    if path.stat().st_size < RECORD:
        return False
    records = np.fromfile(path, dtype="<f8", count=PROBED * FIELDS)
    records = records[: len(records) // FIELDS * FIELDS].reshape(-1, FIELDS)
    with np.errstate(invalid="ignore"):
        time, latitude, longitude, height = records[:, :4].T
        sound = (np.abs(latitude) <= np.pi / 2) & (np.abs(longitude) <= np.pi) & (np.abs(height) < 2e4)
        # Eight letters of a text file decode to a number like 1e-57 or 1e+165, not to an angle or a time.
        return bool((sound & (time >= 0) & (time < 1e10) & (np.abs(latitude) > 1e-9)).all())


def read_sbet(path: Path, *, crs: str | None) -> Trajectory:
    """Read an SBET file."""
    size = path.stat().st_size
    if size % RECORD:
        raise ReadError(f"{path} is truncated: {size} bytes is not a multiple of the {RECORD} bytes of an SBET record")
    if crs is None:
        raise ReadError(
            f"{path} has longitudes and latitudes, and the survey has no coordinate reference system to project them "
            "to; set read.crs"
        )
    records: NDArray[np.float64] = np.fromfile(path, dtype="<f8").reshape(-1, FIELDS)
    degrees = np.column_stack([np.degrees(records[:, 2]), np.degrees(records[:, 1]), records[:, 3]])
    xyz, _ = reproject(degrees, WGS84, crs, name=path)
    return Trajectory.from_positions(xyz, records[:, 0], source=str(path))


def in_weeks_of(trajectory: Trajectory, first: float, last: float) -> Trajectory:
    """Return a trajectory shifted by whole GPS weeks so that it covers the times of the points."""
    time = trajectory.time
    if time is None or not np.isfinite([first, last]).all() or last <= WEEK or time[-1] > 2 * WEEK:
        return trajectory
    shift = np.floor((first + 1e9) / WEEK) * WEEK - 1e9
    if time[0] + shift > last or time[-1] + shift < first:
        return trajectory
    return Trajectory.from_positions(trajectory.xyz, time + shift, source=trajectory.source)


def coverage_note(trajectory: Trajectory, first: float, last: float) -> str:
    """Return a warning if a trajectory does not cover the times of the points, else an empty string."""
    time = trajectory.time
    if time is None or not np.isfinite([first, last]).all() or (time[0] <= first and last <= time[-1]):
        return ""
    return (
        f"the trajectory {Path(trajectory.source).name} covers {time[0]:.3f} to {time[-1]:.3f} s, "
        f"the points have {first:.3f} to {last:.3f} s"
    )


def distance_note(trajectory: Trajectory, low: ArrayLike, high: ArrayLike) -> str:
    """Return a warning if a trajectory lies far from the extent of the points in plan, else an empty string."""
    corners = np.array([np.asarray(low)[:2], np.asarray(high)[:2]], dtype=np.float64)
    if not np.isfinite(corners).all():
        return ""
    metres = shapely.box(*corners.ravel()).distance(shapely.LineString(trajectory.xyz[:, :2]))
    if metres <= NEAR:
        return ""
    return (
        f"the trajectory {Path(trajectory.source).name} is {metres:,.0f} m from the points, and stations and offsets "
        "are wrong: it has another coordinate system, or belongs to another survey"
    )
