"""Coordinate reference systems of files: options, sidecars and reprojection."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pyproj
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.formats.content import unpacked_name
from mlsroad_pipeline.formats.files import FileKey, atomic_file, file_key, log_once

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
        log_once(key[0], f"holds no coordinate reference system that PROJ can parse: {text[:60]!r}")
        return None
    log_once(key[0], f"holds the coordinate reference system {system.name}")
    return str(system.to_wkt())


def write_sidecar(path: Path, crs: str | None) -> None:
    """Write a CRS as WKT beside a file whose format holds none; None writes nothing."""
    if crs:
        with atomic_file(path.with_name(_stem(path) + SIDECAR)) as stream:
            stream.write(crs.encode() + b"\n")


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
