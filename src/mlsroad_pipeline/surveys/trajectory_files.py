"""Reader and writer of trajectories: CSV, whitespace-separated text, SBET (read only)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.formats.files import named_errors
from mlsroad_pipeline.surveys.sbet import is_sbet, read_sbet

_NAMES = {
    "time": ("time", "gps_time", "gpstime", "timestamp", "t", "seconds", "sow"),
    "x": ("x", "easting", "east", "e"),
    "y": ("y", "northing", "north", "n"),
    "z": ("z", "height", "altitude", "elevation", "up", "h"),
}
_COMMENTS = ("#", "%", "//")
_DECIMAL_COMMA = re.compile(r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$")


def read_trajectory(
    path: str | Path,
    *,
    columns: Sequence[str] | None = None,
    crs: str | None = None,
    factors: NDArray[np.float64] | None = None,
) -> Trajectory:
    """Read a trajectory from a text file or from SBET, which is recognised by its content.

    Values are separated by semicolons, tabs, commas or blanks; all but commas allow decimal commas. Lines that begin
    with ``#``, ``%`` or ``//`` are comments.
    """
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such trajectory file")
    with named_errors(source, "a trajectory"):
        return _read_trajectory(source, columns, crs, factors)


def _read_trajectory(
    source: Path, columns: Sequence[str] | None, crs: str | None, factors: NDArray[np.float64] | None
) -> Trajectory:
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
    if columns is not None:
        names = [_meaning(name) for name in columns]
    elif has_names:
        names = [_meaning(name) for name in rows[0][1]]
    else:
        names = ["time", "x", "y", "z"]
    missing = [name for name in ("x", "y", "z") if name not in names]
    if missing:
        raise ReadError(
            f"{source}: a trajectory needs the column {missing[0]} (has {', '.join(columns or rows[0][1])})"
        )
    columns_of = {name: names.index(name) for name in _NAMES if name in names}
    body = rows[1:] if has_names else rows
    if not body:
        raise ReadError(f"{source}: no positions in the file")
    values = np.array([_numbers(source, number, words, columns_of) for number, words in body])
    table = dict(zip(columns_of, values.T, strict=True))
    xyz = np.column_stack([table["x"], table["y"], table["z"]]) * (1.0 if factors is None else factors)
    return Trajectory.from_positions(xyz, table.get("time"), source=str(source))


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
