"""Coordinate reference systems of files: options, sidecars, reprojection, and units as factors to metres."""

import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyproj
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.formats.base import BY_CRS, ReadOptions
from mlsroad_pipeline.formats.files import FileKey, file_key, log_once, unpacked_name, write_atomic

SIDECAR = ".prj"
LARGEST = 1 << 20


def parse_crs(crs: str, *, option: str = "crs") -> str:
    """Return WKT, PROJ or an authority's code as WKT; `ParameterError` with the name of the option if PROJ fails."""
    try:
        return str(pyproj.CRS.from_user_input(crs).to_wkt())
    except pyproj.exceptions.CRSError as error:
        reason = " ".join(str(error).split())
        raise ParameterError(
            f"{option} {crs!r} is not a coordinate reference system ({reason}); give a code such as EPSG:28992, or WKT"
        ) from error


@lru_cache(maxsize=64)
def parsed_crs(crs: str) -> pyproj.CRS | None:
    """Return a system by its WKT or code; None where PROJ cannot parse it."""
    try:
        return pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError:
        return None


@lru_cache(maxsize=64)
def is_same_crs(one: str, other: str) -> bool:
    """Return whether two systems are equal, whatever their names and the order of their axes; False if PROJ fails."""
    if one == other:
        return True
    first, second = parsed_crs(one), parsed_crs(other)
    return first is not None and second is not None and bool(first.equals(second, ignore_axis_order=True))


def crs_label(crs: str | None) -> str:
    """Return a short name of a CRS for messages."""
    return "none" if crs is None else crs.partition('"')[2].partition('"')[0] or shortened(crs, 40)


def _stem(path: Path) -> str:
    name = unpacked_name(path)
    return name.rpartition(".")[0] or name


def sidecar_crs(path: Path) -> str | None:
    """Return the WKT of the ``.prj`` file beside a file; None without one, or if PROJ cannot parse it (logged)."""
    beside = next((p for e in (SIDECAR, SIDECAR.upper()) if (p := path.with_name(_stem(path) + e)).is_file()), None)
    return None if beside is None else _sidecar(file_key(beside))


@lru_cache(maxsize=64)
def _sidecar(key: FileKey) -> str | None:
    with Path(key[0]).open("rb") as stream:
        text = stream.read(LARGEST).decode("utf-8-sig", "replace").strip()
    system = parsed_crs(text)
    if system is None:
        log_once(key[0], f"holds no coordinate reference system that PROJ can parse: {shortened(text, 60)!r}")
        return None
    log_once(key[0], f"holds the coordinate reference system {system.name}")
    return str(system.to_wkt())


def write_sidecar(path: Path, crs: str | None) -> None:
    """Write a CRS as WKT beside a file whose format holds none; None writes nothing."""
    if crs:
        write_atomic(path.with_name(_stem(path) + SIDECAR), crs.encode() + b"\n")


@lru_cache(maxsize=64)
def is_geographic(crs: str | None) -> bool:
    """Return whether a system has coordinates in degrees; False without one, or if PROJ cannot parse it."""
    system = None if crs is None else parsed_crs(crs)
    return system is not None and bool(system.is_geographic)


def place_outside(crs: str, x: float, y: float, *, margin: float = 15.0) -> str | None:
    """Return longitude and latitude of a place, in metres, that lies outside the area of a system as WKT.

    ``margin`` is the accepted distance beyond the area in degrees: Norway is mapped in one zone up to 13 degrees beyond
    it. None if the place lies inside, or the area is unknown.
    """
    try:
        system = pyproj.CRS.from_user_input(crs)
        area, geodetic = system.area_of_use, system.geodetic_crs
        if area is None or geodetic is None or not system.is_projected:
            return None
        longitude, latitude = _transformer(crs, geodetic.to_wkt()).transform(x, y)
    except pyproj.exceptions.ProjError:
        return None
    if not np.isfinite([longitude, latitude]).all():
        return "no place on the earth"
    half = ((area.east - area.west) % 360 or 360) / 2
    beside = abs((longitude - area.west - half + 180) % 360 - 180) - half
    inside = beside <= margin and area.south - margin <= latitude <= area.north + margin
    return None if inside else f"longitude {longitude:.4f}, latitude {latitude:.4f}"


def reproject(
    world: NDArray[np.float64], source: str | None, target: str, *, name: Path
) -> tuple[NDArray[np.float64], str]:
    """Transform world coordinates of shape (n, 3) from one system as WKT to another, as WKT or a code.

    The results are float64 in metres, or degrees and height, and the target as WKT; heights change where both systems
    have them. `DataError`, which names the file, without a source system, or for points where the target is not
    defined.
    """
    wkt = parse_crs(target)
    if source is None:
        raise DataError(f"{name} states no coordinate reference system to reproject from; set crs")
    try:
        x, y, z = world.T
        moved = np.stack(_transformer(source, wkt).transform(x, y, z, errcheck=True), axis=1)
    except pyproj.exceptions.ProjError as error:
        raise DataError(f"{name} cannot be reprojected to {target}: {error}") from error
    return moved, wkt


@lru_cache(maxsize=16)
def _transformer(source: str, target: str) -> pyproj.Transformer:
    return pyproj.Transformer.from_crs(source, target, always_xy=True)


ANGLES = re.compile(r"degree|radian|gr?ad|arc|\bgon\b|centesimal", re.IGNORECASE)  # names of units of angles
SAME_UNIT = 1e-7  # relative tolerance within which two units are equal: a foot and a US survey foot differ by 2e-6


class CrsUnits(NamedTuple):
    """Units of a system."""

    kind: str  # ``"projected"``, ``"geographic"`` (degrees), ``"geocentric"`` or ``"other"``
    flat: tuple[str, float]  # name of the unit of x and y, and its length in metres (its size in radians for degrees)
    height: tuple[str, float] | None  # those of the heights; None where the system has none


@lru_cache(maxsize=64)
def crs_units(crs: str) -> CrsUnits | None:
    """Return the units of a system as WKT; None where PROJ cannot parse it, or it has heights only."""
    system = parsed_crs(crs)
    if system is None:
        return None
    axes = [(axis.direction, axis.unit_name, axis.unit_conversion_factor) for axis in system.axis_info]
    heights = [(name, factor) for direction, name, factor in axes if direction in ("up", "down")]
    flat = [(name, factor) for direction, name, factor in axes if direction not in ("up", "down")]
    if not flat:
        return None
    kinds = (("projected", system.is_projected), ("geographic", system.is_geographic))
    kind = next((name for name, holds in (*kinds, ("geocentric", system.is_geocentric)) if holds), "other")
    return CrsUnits(kind, flat[0], heights[0] if heights else None)


def with_units(options: ReadOptions, crs: str | None, source: Path) -> ReadOptions:
    """Return options with numbers for units: those of the coordinate reference system where the options refer to it.

    The `crs` of the options takes precedence over the file's, which is given as WKT, and that over a sidecar. Heights
    without a unit of their own have that of x and y. `DataError` if the system states a unit that is not a length.
    """
    if options.units != BY_CRS:
        return options
    system = parse_crs(options.crs) if options.crs else crs or sidecar_crs(source)
    units = None if system is None else crs_units(system)
    if units is None:
        return replace(options, units=1.0)
    lengths = units.kind == "projected" or (units.kind == "other" and not ANGLES.search(units.flat[0]))
    flat = units.flat[1] if lengths else 1.0
    height = flat if units.height is None else units.height[1]
    if not (0 < flat < np.inf and 0 < height < np.inf):
        raise DataError(
            f"{source}: its coordinate reference system states units of {flat:g} m, of heights {height:g} m; set units"
        )
    height_units = height if options.height_units is None else options.height_units
    return replace(options, units=flat, height_units=height_units)


def auto_note(options: ReadOptions, crs: str | None, source: Path) -> str:
    """Return a sentence on the conversion to metres; empty if the options set the units or nothing is converted."""
    if options.units != BY_CRS:
        return ""
    flat, _, height = with_units(options, crs, source).factors.tolist()
    if flat == height == 1.0:
        return ""
    what = "coordinates" if flat == height else "x and y" if height == 1.0 else "heights"
    factor = height if flat == 1.0 else flat
    other = f", heights of {height:.10g} m" if flat not in (1.0, height) and height != 1.0 else ""
    return (
        f"{what} are converted from units of {factor:.10g} m{other}, as the coordinate reference system states; "
        "units: metre says otherwise"
    )


@lru_cache(maxsize=64)
def in_metres(crs: str, flat: float, height: float | None = None) -> str:
    """Return the system of coordinates that were converted to metres by factors of x and y, and of heights.

    It has the same projection and heights in metres, without the code; the system itself where its units are others.
    """
    height = flat if height is None else height
    if (flat == 1.0 and height == 1.0) or crs_units(crs) is None:
        return crs
    described = pyproj.CRS.from_user_input(crs).to_json_dict()
    if not _set_metres(described, flat, height):
        return crs
    return str(pyproj.CRS.from_json_dict(described).to_wkt())


def _set_metres(described: dict[str, Any], flat: float, height: float) -> bool:
    """Set metres as the unit of axes that have the given ones, and return whether there are any."""
    parts = [*described.get("components", ()), *([described["source_crs"]] if "source_crs" in described else [])]
    changed = any([_set_metres(part, flat, height) for part in parts])
    for axis in described.get("coordinate_system", {}).get("axis", ()):
        unit, factor = axis.get("unit"), height if axis.get("direction") in ("up", "down") else flat
        size = unit.get("conversion_factor") if isinstance(unit, dict) and unit.get("type") == "LinearUnit" else None
        if factor != 1.0 and size is not None and abs(size / factor - 1.0) <= SAME_UNIT:
            axis["unit"], changed = "metre", True
    if changed:
        described.pop("id", None)
        described["name"] = " + ".join(part["name"] for part in parts) if parts else described["name"] + " in metres"
    return changed
