"""Layers of an edited GeoPackage as rows, and what of them cannot be compared with the inventory."""

import sqlite3
import warnings
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.inventory_files.crs_checks import is_other_system
from mlsroad_pipeline.inventory_files.geopackage_tables import own_views
from mlsroad_pipeline.inventory_files.road_inventory import LAYERS

TEXT = ("status", "checked_class", "class", "kind")
"""Fields whose edits are corrections."""

_MOVED = 0.01  # distance of the centre of a box from the place of its vehicle that is an edit, metres
_FAR = 200.0  # distance of a drawn object or vertex from the inventory that is named, metres
_SHAPEFILE = 10  # characters of a name in a Shapefile
OBJECTS = ("objects", *LAYERS)
"""Layers of objects."""

_NEEDED = ("object_id", "kind", "x", "y", "z")
_OF_LINES = ("line_id", "kind", "x", "y")
_WAL = 2  # version of the format in the header of an SQLite file with a write-ahead log


def read_layers(path: Path, system: CRS | None, notes: list[str]) -> dict[str, gpd.GeoDataFrame]:
    """Return the layers of objects; `notes` gets a sentence for each part that cannot be compared."""
    read = _read(path, notes)
    layers = {name: _checked(path, name, frame, system, _NEEDED) for name, frame in read.items() if name in OBJECTS}
    for name, frame in layers.items():
        notes += [f"layer {name!r} has no field {column!r}" for column in TEXT if column not in frame]
    return layers


def read_line_layers(path: Path, system: CRS | None, notes: list[str]) -> dict[str, gpd.GeoDataFrame]:
    """Return the layers of lines."""
    read = _read(path, notes)
    return {name: _checked(path, name, frame, system, _OF_LINES) for name, frame in read.items() if name in LINE_LAYERS}


def _read(path: Path, notes: list[str]) -> dict[str, Any]:
    """Return the layers of an inventory as they are."""
    if not path.is_file():
        raise ReadError(f"{path}: no such GeoPackage")
    notes += _missing_log(path)
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            base.execute("SELECT table_name FROM gpkg_contents").fetchall()  # GDAL prints errors of its own
            views = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'view'")}
            own = own_views(base)  # edits in them have reached `objects`
        with warnings.catch_warnings(record=True) as said:  # by GDAL, for each layer again
            warnings.simplefilter("always", RuntimeWarning)
            names = [str(name) for name in pyogrio.list_layers(path)[:, 0]]
            chosen = [name for name in (*OBJECTS, *LINE_LAYERS) if name in names and name not in own]
            options = {"on_invalid": "ignore", "fid_as_index": True}
            layers = {name: gpd.read_file(path, layer=name, **options) for name in chosen if name not in views}
            boxes = layers.get("vehicles")
            if "vehicles" in own:
                boxes = gpd.read_file(path, layer="vehicles", **options)
                layers["objects"] = _with_boxes(layers["objects"], boxes)
        notes += dict.fromkeys(printable(warning.message) for warning in said)
        notes += _moved_boxes(boxes)
    except (sqlite3.Error, pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, ValueError) as error:
        raise ReadError(f"{path}: not a GeoPackage: {' '.join(str(error).split())}") from error
    if views.intersection(chosen):
        name = sorted(views.intersection(chosen))[0]
        raise ReadError(f"{path}: layer {name!r} is a view, not a table: save the copy with its layers as they were")
    if not layers:
        raise ReadError(
            f"{path} has none of the layers objects, {', '.join((*LAYERS, *LINE_LAYERS))}: it is not an inventory of "
            "mlsroad"
        )
    return layers


def _with_boxes(frame: gpd.GeoDataFrame, boxes: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """Return the objects; new ones of the view `vehicles`, drawn or copied, have their box: they have no point."""
    is_copy = frame["object_id"].duplicated(keep=False) & frame.geometry.isna()
    frame = frame.assign(object_id=frame["object_id"].mask(is_copy))
    drawn = frame["object_id"].isna() & frame.geometry.isna()
    return frame.set_geometry(frame.geometry.where(~drawn, boxes.geometry.reindex(frame.index)))


def _moved_boxes(boxes: Any) -> list[str]:
    """Return a sentence about boxes of vehicles that no longer lie around their place: only points are moved."""
    if not isinstance(boxes, gpd.GeoDataFrame) or not {"object_id", "x", "y"} <= set(boxes):
        return []
    known = boxes[boxes["object_id"].notna() & ~boxes["object_id"].duplicated(keep=False)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # in degrees
        centres = known.geometry.centroid
    apart = np.hypot(centres.x - known["x"], centres.y - known["y"]) > _MOVED
    numbers = known.loc[apart, "object_id"].astype("int64").tolist()
    if not numbers:
        return []
    return [f"{len(numbers)} boxes of layer 'vehicles' were moved ({_first(numbers)}): move the points of 'objects'"]


def _first(numbers: Sequence[int]) -> str:
    return "object_id " + ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")


def _missing_log(path: Path) -> list[str]:
    with path.open("rb") as stream:
        head = stream.read(20)
    log = path.with_name(f"{path.name}-wal")
    if len(head) < 20 or head[18] != _WAL or log.exists():
        return []
    return [
        f"{log.name} is missing, which may hold the last edits: close the file in the other program and copy it again"
    ]


def _checked(path: Path, name: str, frame: Any, system: CRS | None, needed: Sequence[str]) -> gpd.GeoDataFrame:
    """Return a layer with the names of its fields whole; raise an error if it is none of an inventory."""
    if not isinstance(frame, gpd.GeoDataFrame):
        raise ReadError(f"{path}: layer {name!r} has no geometry: it is not an inventory of mlsroad")
    if is_other_system(frame.crs, system):
        raise DataError(
            f"{path}: layer {name!r} is in {frame.crs.name}, the inventory in {system.name if system else ''}: "
            "save the copy in the system of the inventory"
        )
    frame = frame.rename(columns={column[:_SHAPEFILE]: column for column in TEXT if column not in frame})
    for column in needed:
        if column not in frame:
            raise ReadError(f"{path}: layer {name!r} has no field {column!r}")
    return frame


def rows_of(frame: gpd.GeoDataFrame, layer: str, notes: list[str]) -> list[dict[str, Any]]:
    """Return the rows of a layer with `place`, its point, and `centre`, that of any geometry; None without one."""
    rows, unread = [], []
    shapes = frame.geometry.to_numpy()
    for values, shape in zip(frame.drop(columns=frame.geometry.name).to_dict("records"), shapes, strict=True):
        row = {name: None if pd.isna(value) else value for name, value in values.items()}
        row = {**row, **{name: str(row.get(name) or "").strip() for name in TEXT}}
        row["object_id"] = None if row["object_id"] in (None, 0) else int(row["object_id"])
        row["centre"] = None if shape is None or shape.is_empty else _centre(shape)
        row["place"] = None if layer == "vehicles" or row["centre"] is None else _place(shape)
        if row["object_id"] is not None and (row["centre"] if layer == "vehicles" else row["place"]) is None:
            unread.append(row["object_id"])
        rows.append(row)
    if unread:
        notes.append(f"{len(unread)} objects of layer {layer!r} have no {_wanted(layer)} ({_first(unread)})")
    return rows


def far_away(what: str, drawn: ArrayLike, known: NDArray[np.float64]) -> list[str]:
    """Return a sentence about drawn places that are far from those of the inventory, such as (0, 0)."""
    places = np.asarray(drawn, np.float64).reshape(-1, 2)
    if not len(places) or not len(known):
        return []
    apart = cKDTree(known[:, :2]).query(places)[0]
    n, (x, y) = int((apart > _FAR).sum()), places[np.argmax(apart)]
    return [f"{n} {what} lie up to {apart.max():,.0f} m from the inventory, at ({x:g}, {y:g}): check them"] if n else []


def _wanted(layer: str) -> str:
    return "geometry" if layer == "vehicles" else "single point"


def _centre(shape: Any) -> tuple[float, float, float | None] | None:
    coordinates = shapely.get_coordinates(shape, include_z=True)
    if not np.isfinite(coordinates[:, :2]).all():
        return None
    centre, heights = shape.centroid, coordinates[:, 2]
    return float(centre.x), float(centre.y), None if np.isnan(heights).any() else float(heights.mean())


def _place(shape: Any) -> tuple[float, float, float | None] | None:
    """Return a point, also that of a multipoint of one."""
    coordinates = shapely.get_coordinates(shape, include_z=True)
    if shape.geom_type not in ("Point", "MultiPoint") or len(coordinates) != 1:
        return None
    x, y, z = (float(value) for value in coordinates[0])
    return x, y, None if np.isnan(z) else z
