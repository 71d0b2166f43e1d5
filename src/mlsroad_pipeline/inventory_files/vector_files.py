"""Road inventory as CSV, GeoJSON, FlatGeobuf, GML and Shapefile."""

import logging
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS
from mlsroad_pipeline.algorithms.inventory.road.places import PLACE_FIELDS
from mlsroad_pipeline.algorithms.inventory.road.sight import SIGHT_FIELDS
from mlsroad_pipeline.algorithms.inventory.road.table import ROAD_FIELDS
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.road_inventory import (
    ATTRIBUTE,
    Layer,
    RoadInventory,
    attributes,
    base_points,
    checked,
    fields_with_notes,
    hulls,
    is_note,
    line_attributes,
    line_shapes,
    path_of,
    vehicle_boxes,
    write_whole,
)

logger = logging.getLogger(__name__)

CSV_TYPES = {"int64": "Integer64", "float64": "Real", "str": "String"}
"""Type of a column to the type in a ``.csvt`` file."""

SHAPEFILE_NAMES = {
    "lean_azimuth": "lean_az", "crown_diameter": "crown_diam", "panel_bottom": "panel_low", "panel_centre": "panel_mid",
    "panel_height": "panel_h", "panel_width": "panel_w", "panel_shape": "panel_shp", "facing_from": "facing_src",
    "visible_share": "visible", "point_count": "points", "disagreeing_share": "other_cls", "file_count": "files",
    "passes_there": "passes_of", "scanners_there": "scanner_of", "least_height": "height_min",
    "most_height": "height_max", "from_station": "from_stat", "first_time": "first_sec", "last_time": "last_sec",
    "model_version": "model", "checked_class": "checked", "left_offset": "left_off", "right_offset": "right_off",
    "clearance_offset": "clear_off", "clearance_class": "clear_cls", "clearance_object": "clear_obj",
    "intrusion_offset": "intr_off", "intrusion_class": "intr_cls", "intrusion_object": "intr_obj",
    "least_width": "width_min", "least_clearance": "clear_min",
}  # fmt: skip
"""Field to its name of at most ten characters in a Shapefile; the others keep theirs."""

TEXT_BYTES = 254
"""Largest length of a text in a Shapefile, bytes of UTF-8."""

_NAME_BYTES = 10  # of a field in a Shapefile
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_WGS84 = "OGC:CRS84"
_SECONDS = ("first_time", "last_time")  # whole numbers: a Shapefile has no room for their decimals


def prj_text(crs: CRS, source: str) -> str:
    """Return a coordinate reference system as the content of a ``.prj`` file; raise DataError if it has none."""
    try:
        return str(crs.to_wkt("WKT1_ESRI"))
    except ProjError as error:
        raise DataError(
            f"{source}: the coordinate reference system {crs.name!r} cannot be written as .prj; leave csv, shapefile "
            "and dxf out of label.export"
        ) from error


def write_prj(crs: CRS | None, path: Path) -> list[Path]:
    """Write a ``.prj`` file, none without a system."""
    if crs is None:
        return []
    write_atomic(path, prj_text(crs, str(path)).encode())
    return [path]


def without_formulas(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose texts no spreadsheet runs: an apostrophe stands before those that begin like a formula."""
    texts = [name for name in table.columns if not pd.api.types.is_numeric_dtype(table[name])]

    def plain(value: Any) -> Any:
        return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value

    return table.assign(**{str(name): table[name].map(plain) for name in texts})


def write_csv(inventory: RoadInventory, folder: Path) -> list[Path]:
    """Write all fields as ``inventory.csv`` (UTF-8, footprints as WKT), types, system and sections of the road."""
    target = folder / "inventory.csv"
    table, crs = checked(inventory, target)
    columns = attributes(table).assign(footprint=table["footprint"])
    written = _write_table(columns, target)
    types, fields = target.with_suffix(".csvt"), fields_with_notes(table)
    text = ",".join(f'"{CSV_TYPES[fields[str(name)].dtype]}"' for name in columns) + "\n"
    write_atomic(types, text.encode())
    written += [types, *write_prj(crs, target.with_suffix(".prj"))]
    written += _write_table(inventory.sections, folder / "sections.csv")
    written += _write_table(inventory.lines, folder / "lines.csv")
    for name, (rows, _, _) in inventory.road.items():
        written += _write_table(rows, folder / f"{name}.csv")
    return written


def _write_table(table: pd.DataFrame | None, path: Path) -> list[Path]:
    """Write a table as CSV, if there is one."""
    if table is None:
        return []
    write_atomic(path, without_formulas(table).to_csv(index=False, lineterminator="\n").encode())
    return [path]


def to_wgs84(crs: CRS | None, source: str) -> Transformer:
    """Return the transformation to longitude and latitude."""
    if crs is None:
        raise DataError(
            f"{source}: GeoJSON needs longitudes and latitudes, and the survey has no coordinate reference system; "
            "set label.crs (--crs) or leave geojson out of label.export"
        )
    try:
        return Transformer.from_crs(crs.to_2d(), _WGS84, always_xy=True)
    except ProjError as error:
        raise DataError(
            f"{source}: the coordinate reference system {crs.name!r} cannot be transformed to longitude and latitude; "
            "leave geojson out of label.export"
        ) from error


def write_geojson(inventory: RoadInventory, folder: Path) -> list[Path]:
    """Write the base points as ``inventory.geojson`` (RFC 7946): longitudes, latitudes, elevations of the survey."""
    target = folder / "inventory.geojson"
    table, crs = checked(inventory, target)
    moved = to_wgs84(crs, str(target)).transform(table["x"].to_numpy(), table["y"].to_numpy())
    points = shapely.points(np.column_stack([*moved, table["z"].to_numpy()]))
    options = {"RFC7946": "YES", "COORDINATE_PRECISION": "9", "ID_FIELD": "id"}
    columns = attributes(table).assign(crs=crs_name(crs), id=table["object_id"])
    written = _write(target, columns, points, "Point Z", _WGS84, driver="GeoJSON", layer="objects", options=options)
    change = to_wgs84(crs, str(target)).transform
    for layer, (rows, shapes, kind) in further_layers(inventory).items():
        moved = shapely.transform(shapes, change, include_z=True, interleaved=False)
        columns = rows.assign(crs=crs_name(crs), id=rows["line_id"] if layer == "lines" else range(1, len(rows) + 1))
        place = folder / f"{layer}.geojson"
        written += _write(place, columns, moved, kind, _WGS84, driver="GeoJSON", layer=layer, options=options)
    return written


def further_layers(inventory: RoadInventory) -> dict[str, Layer]:
    """Return the layers beside the objects that formats of one layer write as files: lines, measures of the road."""
    lines = inventory.lines
    own = {} if lines is None else {"lines": (line_attributes(lines), line_shapes(lines), "LineString Z")}
    return own | dict(inventory.road)


def crs_name(crs: CRS | None) -> str:
    """Return the code of a system, or its name; empty without one."""
    authority = None if crs is None else crs.to_authority()
    return ":".join(authority) if authority else "" if crs is None else crs.name


def write_flatgeobuf(inventory: RoadInventory, folder: Path) -> list[Path]:
    """Write the base points with all fields as ``inventory.fgb``."""
    target = folder / "inventory.fgb"
    table, crs = checked(inventory, target)
    written = _write(
        target, attributes(table), base_points(table), "Point Z", crs, driver="FlatGeobuf", layer="objects"
    )
    for layer, parts in further_layers(inventory).items():
        written += _write(folder / f"{layer}.fgb", *parts, crs, driver="FlatGeobuf", layer=layer)
    return written


def write_gml(inventory: RoadInventory, target: Path) -> list[Path]:
    """Write the base points with all fields as GML 3.2, lines and others as ``..._lines.gml``, each with its schema."""
    table, crs = checked(inventory, target)
    if crs is not None and crs.to_authority() is None:
        logger.warning("%s has no reference system: GML names them by codes, and %r has none", target.name, crs.name)
    options: dict[str, Any] = {"driver": "GML", "dataset_options": {"FORMAT": "GML3.2"}}
    written = _write(target, attributes(table), base_points(table), "Point Z", crs, layer="objects", **options)
    for layer, parts in further_layers(inventory).items():
        written += _write(target.with_name(f"{target.stem}_{layer}.gml"), *parts, crs, layer=layer, **options)
    return written


def _write(
    path: Path,
    columns: pd.DataFrame,
    geometry: np.ndarray,
    kind: str,
    crs: CRS | str | None,
    *,
    driver: str,
    layer: str,
    options: dict[str, Any] | None = None,
    dataset_options: dict[str, Any] | None = None,
) -> list[Path]:
    frame = gpd.GeoDataFrame(
        columns.reset_index(drop=True), geometry=gpd.GeoSeries(geometry, dtype="geometry"), crs=crs
    )

    def write(folder: Path) -> None:
        place = folder / path.name
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*crs.* was not provided", category=UserWarning)
            pyogrio.write_dataframe(
                frame, place, layer=layer, driver=driver, geometry_type=kind, layer_options=options or {},
                dataset_options=dataset_options or {},
            )  # fmt: skip

    return write_whole(path.parent, write)


def short_name(name: str) -> str:
    """Return the name of a field in a Shapefile."""
    return SHAPEFILE_NAMES.get(name, name)


def _short_names(names: Sequence[str]) -> dict[str, str]:
    """Return the names of fields in a Shapefile; those of attributes are cut to ten different ones."""
    found: dict[str, str] = {name: short_name(name) for name in names if not name.startswith(ATTRIBUTE)}
    for name in (name for name in names if name.startswith(ATTRIBUTE)):
        own, taken = name.removeprefix(ATTRIBUTE), {text.lower() for text in found.values()}
        ends = ("", *map(str, range(1, 1000)))
        cuts = (_cut(f"a_{own}", _NAME_BYTES - len(end)) + end for end in ends)
        found[name] = next(text for text in cuts if text.lower() not in taken)
    return found


def _cut(text: str, size: int) -> str:
    return text.encode()[:size].decode("utf-8", "ignore")


def _short(columns: pd.DataFrame, path: Path) -> pd.DataFrame:
    """Return a table with the names, types and lengths of text that a Shapefile holds; shortened texts are logged."""
    table = columns.copy()
    for name in (name for name in _SECONDS if name in table):
        table[name] = table[name].astype("Int64")
    n_cut = 0
    for name in (n for n in map(str, table) if is_note(n) or (n in FIELDS and FIELDS[n].dtype == "str")):
        text = [None if v is None else _cut(v, TEXT_BYTES) for v in table[name]]
        n_cut += sum(new != old for new, old in zip(text, table[name], strict=True))
        table[name] = pd.Series(text, dtype=object, index=table.index)
    if n_cut:
        logger.warning("%s: %d texts are cut to %d bytes, the limit of a Shapefile", path.name, n_cut, TEXT_BYTES)
    return table.rename(columns=_short_names(list(table.columns)))


def write_shapefile(inventory: RoadInventory, folder: Path) -> list[Path]:
    """Write the folder ``inventory_shp``: a Shapefile per geometry, and the table of its short field names."""
    target = folder / "inventory_shp"
    target.mkdir(parents=True, exist_ok=True)
    table, crs = checked(inventory, target)
    columns, shapes = attributes(table), hulls(table)
    cars, present = (table["kind"] == "vehicle").to_numpy(), ~shapely.is_missing(shapes)
    layers: list[tuple[str, pd.DataFrame, np.ndarray, str]] = [
        ("objects", columns, base_points(table), "Point Z"),
        ("vehicles", columns[cars], vehicle_boxes(table[cars]), "Polygon Z"),
        ("footprints", columns.loc[present, ["object_id", "class", "kind", "score"]], shapes[present], "Polygon"),
    ]
    if inventory.trajectory is not None:
        layers.append(("trajectory", *path_of(inventory.trajectory), "LineString Z"))
    layers += [(layer, *parts) for layer, parts in further_layers(inventory).items()]
    written: list[Path] = []
    for layer, rows, geometry, kind in layers:
        path = target / f"{layer}.shp"
        options = {"ENCODING": "UTF-8", "DBF_DATE_LAST_UPDATE": "2000-01-01"}  # the default is the day of writing
        short = _short(rows, path)
        parts = _write(path, short, geometry, kind, crs, driver="ESRI Shapefile", layer=layer, options=options)
        written += sorted(parts, key=lambda part: part != path)  # the file that programs open comes first
    tables = [columns, *(rows for rows, _, _ in further_layers(inventory).values())]
    fields = {**PLACE_FIELDS, **SIGHT_FIELDS, **ROAD_FIELDS, **LINE_FIELDS, **fields_with_notes(columns)}
    names = [name for name in dict.fromkeys(str(name) for rows in tables for name in rows) if name in fields]
    shorter = _short_names(names)
    described = [(shorter[name], name, fields[name].alias, fields[name].description) for name in names]
    table = pd.DataFrame(described, columns=["shapefile_field", "field", "alias", "description"])
    write_atomic(target / "fields.csv", table.to_csv(index=False, lineterminator="\n").encode())
    return [*written, target / "fields.csv"]
