"""STAC of a delivery, made by pystac: a virtual point cloud of the labelled files, or one item for the survey."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError
from shapely.geometry import mapping

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.scenes.weeks import since_1980, utc_of
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.formats.las.copc import copc_path
from mlsroad_pipeline.formats.las.crs import read_crs
from mlsroad_pipeline.formats.las.dimensions import bit_field, dimension_names, extra_dimension
from mlsroad_pipeline.formats.las.header import LasHeader, read_header
from mlsroad_pipeline.formats.las.records import RecordReader, layers_of, record_dtype
from mlsroad_pipeline.inventory_files.crs_checks import known_system

VPC, ITEM = ".vpc", ".stac.json"
_CHUNK = 2_000_000  # points whose times are read at once
_READ_VERSION = "1.0.0"
"""The only version of STAC that QGIS and PDAL wrench accept in a virtual point cloud."""
_PROCESSING = "https://stac-extensions.github.io/processing/v1.1.0/schema.json"
_GPS, _CREATED, _WRITTEN = "GPS times of the points", "creation date in the file", "last change of the file"
"""Where a date is from, the most certain first."""
_TYPES = {
    ".copc.laz": ("application/vnd.laszip+copc", "data"),
    ".laz": ("application/vnd.laszip", "data"),
    ".gpkg": ("application/geopackage+sqlite3", "data"),
    ".parquet": ("application/vnd.apache.parquet", "data"),
    ".html": ("text/html", "metadata"),
}
"""Ending of a file that STAC names to its media type and role."""
_PDAL_NAMES = {"nir": "Infrared", "scan_angle": "ScanAngleRank", "scan_angle_rank": "ScanAngleRank"}
_NUMBERS = {"f": "floating", "u": "unsigned", "i": "signed"}


def catalogue_ending(path: Path, known: Iterable[str] = (VPC, ITEM)) -> str:
    """Return the ending of a file of STAC, or of another known one; empty for others."""
    return next((ending for ending in known if path.name.lower().endswith(ending)), "")


def stac(name: str = "pystac") -> Any:
    """Return a module of pystac; ParameterError where it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ParameterError(
            f"{VPC} and {ITEM} are written by {name}, which is not installed: install it (pip install "
            "'mlsroad_pipeline[stac]')"
        ) from error


class _Cloud(NamedTuple):
    """A labelled file as STAC describes it: header and times, nothing else of it is read."""

    final: Path  # Its place after the delivery
    n_points: int
    bounds: NDArray[np.float64]  # Minimum and maximum, shape (2, 3), in the unit of the file
    crs: CRS
    schema: dict[str, tuple[int, str]]  # Name in PDAL to bytes and type of a value
    dates: tuple[datetime, datetime]  # First and last
    source: str  # Of the dates


def write_catalogue(
    own: Path, target: Path, places: Mapping[Path, Path], survey: str, properties: Mapping[str, Any]
) -> None:
    """Write a virtual point cloud or an item of STAC to `own`, which becomes `target`.

    `places` are the files that it names, by their places after the delivery; `properties` are those of an item.
    """
    named = sorted(path for path in places if catalogue_ending(path, _TYPES))
    # A file and its cloud-optimised copy have the same points: each point counts once.
    once = [
        path
        for path in named
        if ".laz" in catalogue_ending(path, _TYPES) and Path(copc_path(str(path))) not in {*named} - {path}
    ]
    clouds = [cloud for path in once if (cloud := _described(places[path], path, target)) is not None]
    if not clouds:
        raise DataError(f"{target}: the labelled files have no points")
    if catalogue_ending(target) == VPC:
        names = [_key(cloud.final, target)[: -len(catalogue_ending(cloud.final, _TYPES))] for cloud in clouds]
        found = zip(clouds, names, strict=True)
        items = [_item([cloud], name, {"data": _asset(cloud.final, target)}, {}) for cloud, name in found]
        content = stac().ItemCollection(items, clone_items=False).to_dict()
        content["features"] = [{**item, "stac_version": _READ_VERSION} for item in content["features"]]
    else:
        item = _item(clouds, survey, {_key(path, target): _asset(path, target) for path in named}, properties)
        item.stac_extensions.append(_PROCESSING)
        content = item.to_dict()
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    write_atomic(own, text.encode() + b"\n")


def _described(path: Path, final: Path, target: Path) -> _Cloud | None:
    """Describe a labelled file; None if it has no points."""
    header = read_header(path)
    if not header.n_points:
        return None
    crs = known_system(read_crs(header, path))
    if crs is None:
        raise DataError(
            f"{target}: STAC needs longitudes and latitudes, and {final} has no coordinate reference system; "
            "label the survey with label.crs (--crs)"
        )
    return _Cloud(final, header.n_points, header.bounds, crs, _schema(header), *_dates(path, header))


def _schema(header: LasHeader) -> dict[str, tuple[int, str]]:
    """Return the dimensions as PDAL names and reads them: coordinates, angles and scaled values as numbers."""
    found, fields = {name.upper(): (8, "floating") for name in "xyz"}, record_dtype(header)
    for name in dimension_names(header)[3:]:
        bits, extra = bit_field(header, name), extra_dimension(header, name)
        dtype = fields[name if bits is None else bits.field]
        size, kind = dtype.base.itemsize, _NUMBERS[dtype.base.kind]
        if extra is not None and (extra.scale is not None or extra.offset is not None):
            size, kind = 8, "floating"
        elif name.startswith("scan_angle"):
            size, kind = 4, "floating"
        pdal = _PDAL_NAMES.get(name, "".join(part.capitalize() for part in name.split("_"))) if extra is None else name
        names = [f"{pdal}{i}" for i in range(dtype.shape[0])] if dtype.shape else [pdal]
        found |= dict.fromkeys(names, (size, kind))
    return found


def _dates(path: Path, header: LasHeader) -> tuple[tuple[datetime, datetime], str]:
    """Return when a file was recorded: by its GPS times, else the dates of the file, which are later."""
    times = _gps_times(path, header)
    if times is not None:
        return (utc_of(times[0]), utc_of(times[1])), _GPS
    year, day = header.integer("year"), header.integer("day")
    if 1970 < year < 3000 and 1 <= day <= 366:  # mlsroad writes the first day of 1970 where it knows none
        created = datetime(year, 1, 1, tzinfo=UTC) + timedelta(days=day - 1)
        return (created, created), _CREATED
    written = datetime.fromtimestamp(int(path.stat().st_mtime), UTC)
    return (written, written), _WRITTEN


def _gps_times(path: Path, header: LasHeader) -> tuple[float, float] | None:
    """Return the first and last time of the points in seconds since 1980; None if they have none with a date."""
    if "gps_time" not in (record_dtype(header).names or ()):
        return None
    first, last, n_points = np.inf, -np.inf, header.n_points
    with RecordReader(path, header, n_threads=2, select=layers_of(header, ["gps_time"])) as reader:
        # The first points alone show seconds of the week.
        for start, stop in [(0, 1000), *((start, start + _CHUNK) for start in range(0, n_points, _CHUNK))]:
            times = since_1980(reader.read(start, min(stop, n_points))["gps_time"])
            if not np.isfinite(times).any():
                return None
            first, last = min(first, float(np.nanmin(times))), max(last, float(np.nanmax(times)))
    return first, last


def _item(clouds: Sequence[_Cloud], name: str, assets: Mapping[str, Any], properties: Mapping[str, Any]) -> Any:
    """Return an item of labelled files with its extensions."""
    crs = clouds[0].crs
    other = next((cloud for cloud in clouds if not cloud.crs.equals(crs, ignore_axis_order=True)), None)
    if other is not None:
        raise DataError(
            f"{other.final} is in {other.crs.name}, {clouds[0].final} in {crs.name}: an item has one coordinate "
            f"reference system; write a {VPC}"
        )
    low = np.min([cloud.bounds[0] for cloud in clouds], axis=0)
    high = np.max([cloud.bounds[1] for cloud in clouds], axis=0)
    box = shapely.box(*low[:2], *high[:2])
    (west, south, east, north), outline = _in_degrees(crs, box, clouds[0].final)
    source = min((cloud.source for cloud in clouds), key=(_GPS, _CREATED, _WRITTEN).index)
    dates = [date for cloud in clouds if cloud.source == source for date in cloud.dates]
    first, last = min(dates), max(dates)
    item = stac().Item(
        name,
        mapping(outline),
        [west, south, float(low[2]), east, north, float(high[2])],  # heights stay
        first,
        {"mlsroad:datetime_from": source, **properties},
        **({"start_datetime": first, "end_datetime": last} if source == _GPS else {}),
        assets=dict(assets),
    )
    points = stac("pystac.extensions.pointcloud")
    schema = {n: kind for cloud in reversed(clouds) for n, kind in cloud.schema.items()}
    schemas = [points.Schema.create(n, size, points.SchemaType(kind)) for n, (size, kind) in schema.items()]
    # Without statistics: headers have none but bounds, and PDAL wrench reads no incomplete ones.
    points.PointcloudExtension.ext(item, add_if_missing=True).apply(
        sum(cloud.n_points for cloud in clouds), points.PhenomenologyType.LIDAR, "LASzip", schemas
    )
    authority = crs.to_authority(min_confidence=100)
    stac("pystac.extensions.projection").ProjectionExtension.ext(item, add_if_missing=True).apply(
        code=None if authority is None else ":".join(authority),
        wkt2=crs.to_wkt("WKT2_2019"),
        geometry=mapping(box),
        bbox=[*low.tolist(), *high.tolist()],
    )
    return item


def _in_degrees(crs: CRS, box: Any, name: Path) -> tuple[list[float], Any]:
    """Return the bounds of a box in longitudes and latitudes, and its outline."""
    try:
        transformer = Transformer.from_crs(crs.to_2d(), "EPSG:4326", always_xy=True)
        outline = shapely.transform(box, partial(transformer.transform, errcheck=True), interleaved=False)
        west, south, east, north = box.bounds
        # Its own check rejects valid places of conic systems such as EPSG:2154; the corners were checked above.
        return list(transformer.transform_bounds(west, south, east, north)), outline
    except ProjError as error:
        raise DataError(f"{name} cannot be placed in longitudes and latitudes ({crs.name}): {error}") from error


def _asset(final: Path, target: Path) -> Any:
    media, role = _TYPES[catalogue_ending(final, _TYPES)]
    return stac().Asset(_href(final, target), media_type=media, roles=[role])


def _href(final: Path, target: Path) -> str:
    """Return the way to a file from the folder of another; QGIS and PDAL wrench take `./` for relative."""
    place = os.path.join(os.path.realpath(final.parent), final.name)
    return "./" + Path(os.path.relpath(place, os.path.realpath(target.parent))).as_posix()


def _key(final: Path, target: Path) -> str:
    return _href(final, target).removeprefix("./").replace("../", "").replace("/", "_")
