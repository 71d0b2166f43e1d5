"""Standard names of a file's columns, and the units that their names state."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError
from mlsroad_pipeline.formats.base import UNITS, ReadOptions
from mlsroad_pipeline.formats.files import log_once
from mlsroad_pipeline.formats.standard_columns import COLOURS, COORDINATES

# Standard name to its names in other programs, in lower case.
ALIASES: dict[str, tuple[str, ...]] = {
    "x": ("//x", "px", "easting", "east", "x_m", "point x", "x coord", "x coordinate"),
    "y": ("py", "northing", "north", "y_m", "point y", "y coord", "y coordinate"),
    "z": ("pz", "elevation", "height", "altitude", "z_m", "point z", "z coord", "z coordinate"),
    "red": ("r", "diffuse_red"),
    "green": ("g", "diffuse_green"),
    "blue": ("b", "diffuse_blue"),
    "intensity": ("scalar_intensity", "reflectance", "amplitude", "i"),
    "gps_time": ("scalar_gpstime", "gpstime", "timestamp", "gps time", "gps_seconds"),
    "label": ("scalar_label", "semantic"),
}
JOINED = ("rgb", "rgb16")  # columns that are made of several; a column of a file with such a name is not one of them
# Units of `UNITS` to their names in brackets, in lower case.
LENGTHS: dict[str, tuple[str, ...]] = {
    "metre": ("m", "metre", "metres", "meter", "meters"),
    "millimetre": ("mm", "millimetre", "millimetres", "millimeter", "millimeters"),
    "centimetre": ("cm", "centimetre", "centimetres", "centimeter", "centimeters"),
    "kilometre": ("km", "kilometre", "kilometres", "kilometer", "kilometers"),
    "foot": ("ft", "foot", "feet", "international feet"),
    "us_survey_foot": ("us ft", "usft", "us-ft", "ftus", "us survey foot", "us survey feet"),
    "inch": ("in", "inch", "inches"),
}
# Seconds to names of units in brackets.
TIMES: dict[float, tuple[str, ...]] = {
    1.0: ("s", "sec", "second", "seconds"),
    1e-3: ("ms", "millisecond", "milliseconds"),
    1e-6: ("us", "\u00b5s", "\u03bcs", "microsecond", "microseconds"),
    1e-9: ("ns", "nanosecond", "nanoseconds"),
}
RATIOS = ("db", "%", "-")  # units of intensities, which need no conversion
# Relative tolerance within which two units of length are equal: names rarely state which foot is meant.
SAME_FOOT = 1e-5
UNIT = re.compile(r"(?<=\S)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*$")


class _Meaning(NamedTuple):
    """Reading of a column's name: the standard name, whether it is spelled so, and the unit in brackets."""

    standard: str
    exact: bool
    unit: str

    @property
    def rank(self) -> int:
        """Return 0 for an exact name; each a unit and another spelling add one."""
        return (not self.exact) + bool(self.unit)


def _units_of(standard: str) -> tuple[str, ...]:
    groups: Mapping[str, Sequence[tuple[str, ...]]] = {
        **{axis: list(LENGTHS.values()) for axis in COORDINATES},
        "gps_time": list(TIMES.values()),
        "intensity": [RATIOS],
    }
    return tuple(unit for group in groups.get(standard, ()) for unit in group)


def _meaning(name: str) -> _Meaning | None:
    """Return the reading of a name; None where it is no standard one, or its brackets hold no unit of the quantity."""
    lower = name.lower().strip()
    found = UNIT.search(lower)
    for text, unit in ((lower, ""), (lower[: found.start()], found[1]) if found else (lower, "")):
        standard = next((key for key, others in ALIASES.items() if text == key or text in others), None)
        if standard is not None and (not unit or unit in _units_of(standard)):
            return _Meaning(standard, text == standard, unit)
    return None


def names_coordinates(names: Sequence[str]) -> bool:
    """Return whether x, y and z are among names."""
    meanings = [_meaning(name) for name in names]
    return set(COORDINATES) <= {meaning.standard for meaning in meanings if meaning is not None}


def resolve_columns(file_names: Sequence[str], options: ReadOptions, source: Path) -> dict[str, str]:
    """Return standard name to name in the file for its columns; `red`, `green` and `blue` are the parts of `rgb`.

    `MissingColumnError` if a mapped or selected column, or a coordinate, is missing; `DataError` if two names with
    units may be the same coordinate, or a name states another unit than the one that is read.
    """
    chosen = _mapped(file_names, options, source)
    mapped, taken = set(chosen), set(chosen.values())
    best = _best([name for name in file_names if name not in taken], mapped, source)
    for name in file_names:
        if name in taken:
            continue
        meaning = _meaning(name)
        standard = name
        if meaning is not None and meaning.rank == 0:
            standard = meaning.standard
        elif meaning is not None and best.get(meaning.standard) == name:
            standard = meaning.standard
            log_once(str(source), f"column {name!r} is read as {standard}")
        chosen[f"file_{name}" if standard in chosen or standard in JOINED else standard] = name
    for name in COORDINATES:
        if name not in chosen:
            raise _missing(name, file_names, source, f"; set columns, such as {{{name}: NAME}}")
    if options.only is not None:
        chosen = _selected(chosen, options.only, source)
    for name, column in chosen.items():
        _check_unit(name, column, name in mapped, options, source)
    return chosen


def _best(names: Sequence[str], mapped: set[str], source: Path) -> dict[str, str]:
    """Return the column that is read as each standard name: exact names first, names without units before others."""
    found: dict[str, list[tuple[_Meaning, str]]] = {}
    for name in names:
        meaning = _meaning(name)
        if meaning is not None and meaning.standard not in mapped:
            found.setdefault(meaning.standard, []).append((meaning, name))
    best = {}
    for standard, columns in found.items():
        least = min(meaning.rank for meaning, _ in columns)
        first = {name: meaning.unit for meaning, name in columns if meaning.rank == least}
        best[standard] = next(iter(first))
        if len(first) > 1 and least and any(first.values()):
            both = " and ".join(map(repr, first))
            if standard in COORDINATES:
                metres = next((name for name, unit in first.items() if unit in LENGTHS["metre"]), best[standard])
                raise DataError(
                    f"{source}: columns {both} may be {standard}; set columns, such as {{{standard}: {metres}}}"
                )
            log_once(str(source), f"columns {both} may be {standard}: the first is used; columns sets another")
    return best


def _check_unit(standard: str, column: str, mapped: bool, options: ReadOptions, source: Path) -> None:
    """Raise an error, or log for a mapped column, if a name states another unit than the one that is read."""
    meaning = _meaning(column)
    if meaning is None or not meaning.unit or meaning.standard != standard:
        return
    if standard == "gps_time":
        seconds = next(factor for factor, names in TIMES.items() if meaning.unit in names)
        wanted = "" if options.time_scale != 1.0 or seconds == 1.0 else f"time_scale: {seconds:g}"
    else:
        wanted = _other_length(meaning, options)
    if not wanted:
        return
    if not mapped:
        raise DataError(
            f"{source}: column {column!r} states another unit than the one it is read in; set {wanted}, or map the "
            "column by columns if its name is wrong"
        )
    log_once(str(source), f"column {column!r} is read in another unit than its name states; {wanted} changes that")


def _other_length(meaning: _Meaning, options: ReadOptions) -> str:
    """Return the option for the unit of a coordinate; empty where the coordinate is read in it."""
    if meaning.standard not in COORDINATES:
        return ""
    axis = COORDINATES.index(meaning.standard)
    unit = next(unit for unit, names in LENGTHS.items() if meaning.unit in names)
    if abs(UNITS[unit] / options.factors[axis] - 1.0) <= SAME_FOOT:
        return ""
    return f"{'units' if axis < 2 else 'height_units'}: {unit}"


def _selected(chosen: Mapping[str, str], only: Sequence[str], source: Path) -> dict[str, str]:
    wanted = set(COORDINATES)
    for name in only:
        parts = COLOURS if name == "rgb" else (name,)
        if name != "rgb16" and not set(parts) <= chosen.keys():
            raise _missing(name, list(chosen), source)
        wanted.update(COLOURS if name == "rgb16" else parts)
    return {name: file_name for name, file_name in chosen.items() if name in wanted}


def _mapped(file_names: Sequence[str], options: ReadOptions, source: Path) -> dict[str, str]:
    chosen: dict[str, str] = {}
    for name, wanted in options.columns.items():
        parts = zip(COLOURS, wanted, strict=True) if name == "rgb" else ((name, wanted),)
        for part, column in parts:
            if isinstance(column, int) and 0 <= column < len(file_names):
                chosen[part] = file_names[column]
            elif column in file_names:
                chosen[part] = column
            else:
                raise _missing(column, file_names, source)
    return chosen


def _missing(name: object, have: Sequence[str], source: Path, more: str = "") -> MissingColumnError:
    return MissingColumnError(f"{source} has no column {name!r} (columns: {_some(have)}){more}")


def _some(names: Sequence[str], most: int = 20) -> str:
    """Return the first names: an archive may have a thousand."""
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return (", ".join(names[:most]) or "none") + rest
