"""Inventory in the layers, fields and codes of a user, as a YAML file defines them."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import yaml
from pyproj import CRS

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.inventory_files.geopackage import without_times
from mlsroad_pipeline.inventory_files.road_inventory import (
    LAYERS,
    RoadInventory,
    attributes,
    base_points,
    checked,
    fields_of_layer,
    is_note,
    line_attributes,
    line_shapes,
    vehicle_boxes,
    write_whole,
)
from mlsroad_pipeline.inventory_files.vector_files import to_wgs84, without_formulas

DRIVERS = {
    ".gpkg": "GPKG", ".csv": "CSV", ".geojson": "GeoJSON", ".fgb": "FlatGeobuf", ".shp": "ESRI Shapefile",
    ".gml": "GML",
}  # fmt: skip
"""Ending of a file to its driver of GDAL."""

_OPTIONS: dict[str, dict[str, str]] = {
    ".csv": {"GEOMETRY": "AS_WKT"},
    ".geojson": {"RFC7946": "YES", "COORDINATE_PRECISION": "9"},
    ".shp": {"ENCODING": "UTF-8", "DBF_DATE_LAST_UPDATE": "2000-01-01"},
    ".gpkg": {},
    ".fgb": {},
    ".gml": {},
}
_KEYS = {"from", "codes", "default", "factor", "value"}
_SHAPEFILE_NAME = 10  # characters of a field
_OF_KINDS = {kind: layer for layer, kind in {**LAYERS, **LINE_LAYERS}.items()}


class OwnLayer(NamedTuple):
    """A layer: its name, the kind of its objects or lines, and its fields by name."""

    name: str
    kind: str
    # Column of the inventory; or `from` with `factor`, or with `codes` and `default`; or a fixed `value`
    fields: Mapping[str, Any]


def read_schema(path: Path) -> list[OwnLayer]:
    """Read layers from a YAML file; errors name the file, the layer and the field."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ReadError(f"{path} cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise ReadError(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    layers = content.get("layers") if isinstance(content, Mapping) else None
    if not isinstance(layers, Mapping) or not layers:
        raise ReadError(f"{path}: needs 'layers', each with 'kind' and 'fields'")
    return [_layer(str(name), spec, f"{path}: layer {name!r}") for name, spec in layers.items()]


def _layer(name: str, spec: Any, where: str) -> OwnLayer:
    if not name or set(name) & set('/\\:*?"<>|') or name.startswith("."):
        raise ReadError(f"{where}: the name of a layer is part of a file name: leave out / and the like")
    if not isinstance(spec, Mapping) or spec.get("kind") not in _OF_KINDS:
        kind = spec.get("kind") if isinstance(spec, Mapping) else None
        raise ReadError(f"{where}: unknown kind {kind!r}: use one of {', '.join(_OF_KINDS)}")
    fields = spec.get("fields")
    if not isinstance(fields, Mapping) or not fields:
        raise ReadError(f"{where}: needs 'fields'")
    known = fields_of_layer(_OF_KINDS[spec["kind"]])
    lower = [str(field).lower() for field in fields]
    twice = next((name for name in lower if lower.count(name) > 1 or name in ("geometry", "geom", "fid")), None)
    if twice is not None:
        raise ReadError(f"{where}, field {twice!r}: this name is taken: fields differ by more than capitals")
    for field, source in fields.items():
        column = source.get("from") if isinstance(source, Mapping) else source
        if isinstance(source, Mapping) and (
            set(source) - {"from", "codes", "default", "factor", "value"} or not source
        ):
            raise ReadError(
                f"{where}, field {field!r}: has {', '.join(map(str, source))}: use value, or from and codes"
            )
        if isinstance(source, Mapping) and set(source) == {"value"}:
            continue
        if column not in known and not (spec["kind"] in LAYERS.values() and is_note(str(column))):
            raise ReadError(f"{where}, field {field!r}: {spec['kind']} has no {column!r}: use {', '.join(known)}")
        if isinstance(source, Mapping) and "factor" in source:
            is_text = is_note(str(column)) or known[str(column)].dtype == "str"
            _check_factor(source, is_text, f"{where}, field {field!r}")
        elif isinstance(source, Mapping) and not isinstance(source.get("codes"), Mapping):
            raise ReadError(f"{where}, field {field!r}: needs 'codes', values of {column} to your own, or 'factor'")
    return OwnLayer(name, str(spec["kind"]), fields)


def _check_factor(source: Mapping[str, Any], is_text: bool, where: str) -> None:
    """Raise ReadError unless a column of numbers is multiplied by a number."""
    factor = source["factor"]
    if set(source) != {"from", "factor"} or isinstance(factor, bool) or not isinstance(factor, int | float):
        raise ReadError(f"{where}: factor is a number, beside from alone, got {factor!r}")
    if is_text:
        raise ReadError(f"{where}: {source['from']} is text, which has no factor")


def own_table(layer: OwnLayer, table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of a kind with the fields of a layer; DataError for a value without a code."""
    columns: dict[str, Any] = {}
    used = {str(s.get("from") if isinstance(s, Mapping) else s) for s in layer.fields.values()}
    table = table.assign(**{name: None for name in used if is_note(name) and name not in table})  # nobody gave one
    for field, source in layer.fields.items():
        if not isinstance(source, Mapping):
            columns[str(field)] = table[source].to_numpy()
        elif "value" in source:
            columns[str(field)] = np.full(len(table), source["value"])
        elif "factor" in source:
            columns[str(field)] = (table[source["from"]] * source["factor"]).to_numpy()
        else:
            codes = source["codes"]
            missing = sorted({str(value) for value in table[source["from"]] if value not in codes})
            if missing and "default" not in source:
                raise DataError(
                    f"layer {layer.name!r}, field {field!r}: no code for {source['from']} {missing[0]!r}: add it to "
                    "'codes', or a 'default'"
                )
            columns[str(field)] = [codes.get(value, source.get("default")) for value in table[source["from"]]]
    return pd.DataFrame(columns, index=table.index)


def write_own_schema(inventory: RoadInventory, layers: Sequence[OwnLayer], target: Path) -> list[Path]:
    """Write the layers as one GeoPackage, or as a file per layer beside the target; return the paths."""
    suffix = target.suffix.lower()
    if suffix not in DRIVERS:
        raise ParameterError(f"{target}: a schema of your own is written as {', '.join(DRIVERS)}")
    table, crs = checked(inventory, target)
    parts = [[layer] for layer in layers]
    written: list[Path] = []
    for part in [list(layers)] if suffix == ".gpkg" else parts:
        name = target.name if suffix == ".gpkg" else f"{target.stem}_{part[0].name}{suffix}"
        frames = [_frame(layer, inventory, table, crs, target) for layer in part]

        def write(folder: Path, name: str = name, part: list[OwnLayer] = part, frames: list[Any] = frames) -> None:
            for layer, frame in zip(part, frames, strict=True):
                _write(folder / name, layer, frame)

        with without_times():
            written += write_whole(target.parent, write)
    return written


def _frame(
    layer: OwnLayer, inventory: RoadInventory, table: pd.DataFrame, crs: CRS | None, target: Path
) -> gpd.GeoDataFrame:
    if layer.kind in LAYERS.values():
        rows = table[table["kind"] == layer.kind]
        shapes = vehicle_boxes(rows) if layer.kind == "vehicle" else base_points(rows)
        rows = attributes(rows)
    elif inventory.lines is None:
        raise DataError(f"{target}: layer {layer.name!r}: the inventory has no lines")
    else:
        rows = inventory.lines[inventory.lines["kind"] == layer.kind]
        shapes, rows = line_shapes(rows), line_attributes(rows)
    own = own_table(layer, rows.reset_index(drop=True))
    long = [name for name in own if target.suffix.lower() == ".shp" and len(str(name)) > _SHAPEFILE_NAME]
    if long:
        raise ParameterError(f"{target}: field {long[0]!r} has more than {_SHAPEFILE_NAME} characters: rename it")
    return gpd.GeoDataFrame(own, geometry=gpd.GeoSeries(shapes, dtype="geometry"), crs=crs)


def _write(path: Path, layer: OwnLayer, frame: gpd.GeoDataFrame) -> None:
    suffix = path.suffix.lower()
    kind = "Polygon Z" if layer.kind == "vehicle" else "Point Z" if layer.kind in LAYERS.values() else "LineString Z"
    if suffix == ".geojson":
        to_wgs84(frame.crs, str(path))  # its error where there is no place on the earth
        frame = frame.to_crs("OGC:CRS84")
    frame = without_formulas(frame) if suffix == ".csv" else frame
    options: dict[str, Any] = {"geometry_type": kind, "append": path.exists(), "layer_options": _OPTIONS[suffix]}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*crs.* was not provided", category=UserWarning)
        pyogrio.write_dataframe(frame, path, layer=layer.name, driver=DRIVERS[suffix], **options)
