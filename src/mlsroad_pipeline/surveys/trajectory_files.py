"""Reader of trajectories (CSV, text, SBET of Applanix), and warnings on their times and places."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.algorithms.scenes.weeks import LEAP_SECONDS, WEEK, base_shift
from mlsroad_pipeline.formats.crs import reproject
from mlsroad_pipeline.formats.files import named_errors

FIELDS = 17
RECORD = 8 * FIELDS
WGS84 = "EPSG:4979"
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
        return bool((sound & (np.abs(time) < 1e10) & (np.abs(latitude) > 1e-9)).all())


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
    return Trajectory.from_positions(xyz, _in_order(records[:, 0]), source=str(path))


def in_weeks_of(trajectory: Trajectory, first: float, last: float) -> Trajectory:
    """Return a trajectory in the base of the times of the points: of a week, since 1980, or adjusted by 1e9 s."""
    time = trajectory.time
    if time is None or not np.isfinite([first, last]).all():
        return trajectory
    shift = base_shift(time, first, last)
    if shift == 0.0:
        return trajectory
    return Trajectory.from_positions(trajectory.xyz, time + shift, source=trajectory.source)


def coverage_note(trajectory: Trajectory, first: float, last: float) -> str:
    """Return a warning if a trajectory does not cover the times of the points, else an empty string."""
    time = trajectory.time
    if time is None or not np.isfinite([first, last]).all() or (time[0] <= first and last <= time[-1]):
        return ""
    note = (
        f"the trajectory {Path(trajectory.source).name} covers {time[0]:.3f} to {time[-1]:.3f} s, "
        f"the points have {first:.3f} to {last:.3f} s"
    )
    for leap in LEAP_SECONDS:
        for shift, way, clock in ((leap, "later", "UTC and theirs GPS"), (-leap, "earlier", "GPS and theirs UTC")):
            if time[0] + shift <= first and last <= time[-1] + shift:
                return f"{note}; {leap:.0f} s {way} it covers them, as if its times were {clock} time: shift its times"
    return note


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


_NAMES = {
    "time": ("time", "gps_time", "gpstime", "timestamp", "t", "seconds", "sow"),
    "x": ("x", "easting", "east", "e"),
    "y": ("y", "northing", "north", "n"),
    "z": ("z", "height", "altitude", "elevation", "up", "h"),
}
_RESULTS = ({"object_id"}, {"station", "crossfall", "clearance"})
"""Columns of tables of results that have coordinates too: objects, and measures of the road."""

_COMMENTS = ("#", "%", "//")
_DECIMAL_COMMA = re.compile(r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$")


def read_trajectory(
    path: str | Path, *, crs: str | None = None, factors: NDArray[np.float64] | None = None
) -> Trajectory:
    """Read a trajectory from a text file or from SBET, which is recognised by its content.

    Values are separated by semicolons, tabs, commas or blanks; all but commas allow decimal commas. Lines that begin
    with ``#``, ``%`` or ``//`` are comments.
    """
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such trajectory file")
    with named_errors(source, "a trajectory"):
        return _read_trajectory(source, crs, factors)


def _read_trajectory(source: Path, crs: str | None, factors: NDArray[np.float64] | None) -> Trajectory:
    if is_sbet(source):
        return read_sbet(source, crs=crs)
    lines = [
        (i, line.strip())
        for i, line in enumerate(source.read_text(encoding="utf-8-sig", errors="replace").splitlines(), start=1)
    ]
    rows = [(i, _split(line)) for i, line in lines if line and not line.startswith(_COMMENTS)]
    if not rows:
        raise ReadError(f"{source}: no positions in the file")
    has_names = not _is_number(rows[0][1][0]) or not all(_is_number(word) for word in rows[0][1][1:4])
    said = None if has_names else _names_in_comment(lines, *rows[0])
    names = [_meaning(name) for name in rows[0][1]] if has_names else said or ["time", "x", "y", "z"]
    missing = [name for name in ("x", "y", "z") if name not in names]
    if missing:
        has = shortened(printable(", ".join(rows[0][1])))
        raise ReadError(f"{source}: a trajectory needs the column {missing[0]} (its first line: {has})")
    if result := next((columns for columns in _RESULTS if columns <= {*names}), None):
        raise ReadError(
            f"{source}: a table of results (column {', '.join(sorted(result))}), not a trajectory: name the path of "
            "the vehicle"
        )
    columns_of = {name: names.index(name) for name in _NAMES if name in names}
    body = rows[1:] if has_names else rows
    if not body:
        raise ReadError(f"{source}: no positions in the file")
    values = np.array([_numbers(source, number, words, columns_of) for number, words in body])
    table = dict(zip(columns_of, values.T, strict=True))
    xyz = np.column_stack([table["x"], table["y"], table["z"]]) * (1.0 if factors is None else factors)
    time = table.get("time")
    return Trajectory.from_positions(xyz, None if time is None else _in_order(time), source=str(source))


def _in_order(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return times that go on where rows fall from the end of a week to 0."""
    week = bool(len(time)) and bool(((time >= 0) & (time <= WEEK)).all())
    return time + WEEK * np.concatenate([[0], np.cumsum(np.diff(time) < -WEEK / 2)]) if week else time


def _names_in_comment(lines: Sequence[tuple[int, str]], number: int, words: Sequence[str]) -> list[str] | None:
    """Return the names in the last comment before the first position, if they are one per value and include x, y, z."""
    comments = [line.lstrip("#%/ ") for i, line in lines if i < number and line.startswith(_COMMENTS)]
    names = [_meaning(name) for name in _split(comments[-1])] if comments else []
    return names if len(names) == len(words) and {"x", "y", "z"} <= set(names) else None


def _split(line: str) -> list[str]:
    separator = next((mark for mark in (";", "\t", ",") if mark in line), None)
    words = [word.strip().strip('"') for word in line.split(separator)]
    return words if separator == "," else [_DECIMAL_COMMA.sub(r"\1.\2", word) for word in words]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _meaning(name: str) -> str:
    plain = re.sub(r"\[.*?\]|\(.*?\)", "", name).strip().lower()
    plain = re.sub(r"[\s_]+(m|s|sec|deg)$", "", plain)
    return next((meaning for meaning, names in _NAMES.items() if plain in names), plain)


def _numbers(source: Path, number: int, words: Sequence[str], columns_of: dict[str, int]) -> list[float]:
    if len(words) <= max(columns_of.values()):
        raise ReadError(f"{source}: line {number} has {len(words)} values, {max(columns_of.values()) + 1} are needed")
    for name, column in columns_of.items():
        if not _is_number(words[column]):
            raise ReadError(f"{source}: line {number}: {name} is {words[column]!r}, not a number")
    return [float(words[column]) for column in columns_of.values()]
