"""Road inventory as a GeoPackage: typed layers with field aliases and styles for a GIS."""

import errno
import os
import sqlite3
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely
from pyproj import CRS

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import ADDED_FIELDS, LINE_FIELDS, numbered
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.algorithms.inventory.objects.boxes import polygon_area
from mlsroad_pipeline.algorithms.inventory.objects.sections import part_of_path
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.execution.run_folder import OPEN_ENDINGS
from mlsroad_pipeline.inventory_files import qgis_styles, road_inventory
from mlsroad_pipeline.inventory_files.geopackage_tables import add_metadata, add_tables, add_views, metadata_of

_FIXED_DATE = "2000-01-01T00:00:00.000Z"
_OPTIONS = {"OGR_CURRENT_DATE": _FIXED_DATE, "OGR_SQLITE_SYNCHRONOUS": "OFF", "OGR_SQLITE_JOURNAL": "MEMORY"}
"""Options of GDAL: the default date is the time of writing; the finished file is synced, its parts need not be."""
_POINT, _POLYGON, _LINE = "Point Z", "Polygon Z", "LineString Z"
_OF_FOOTPRINTS = ["object_id", "class", "kind", "score", "height"]  # repeated in the layer of footprints


class _Layer(NamedTuple):
    """A layer: its name, its rows with shapes, and the type of the shapes."""

    name: str
    rows: gpd.GeoDataFrame
    kind: str


def _layer(name: str, table: pd.DataFrame, *, geometry: np.ndarray, kind: str, crs: CRS | None) -> _Layer:
    shapes = gpd.GeoSeries(geometry, dtype="geometry")
    return _Layer(name, gpd.GeoDataFrame(table.reset_index(drop=True), geometry=shapes, crs=crs), kind)


@contextmanager
def without_times() -> Iterator[None]:
    """Write GeoPackages without the time of writing: equal content gives equal bytes."""
    before = {name: pyogrio.get_gdal_config_option(name) for name in _OPTIONS}
    pyogrio.set_gdal_config_options(_OPTIONS)
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options(before)


def write_geopackage(inventory: road_inventory.RoadInventory, path: str | Path) -> None:
    """Write an inventory as layers of a GeoPackage."""
    target = Path(path)
    table, crs = road_inventory.checked(inventory, target)
    layers = _layers(inventory, table, crs)
    # The layer `objects` repeats the objects of the others and would cover their symbols.
    styles = {
        layer: qgis_styles.qml(layer, scaled=crs is not None, drawn=layer != "objects") for layer in qgis_styles.LAYERS
    }

    columns, boxes = _columns_of_kinds(table), road_inventory.vehicle_boxes(table)
    boxes[(table["kind"] != "vehicle").to_numpy()] = None

    def write(path: Path) -> None:
        _write_layers(path, layers)
        add_views(path, columns, boxes, date=_FIXED_DATE)
        add_tables(path, styles, date=_FIXED_DATE)
        add_metadata(path, metadata_of(inventory), date=_FIXED_DATE)

    _write_whole(target, write)


def check_closed(path: Path) -> None:
    """Raise ParameterError where SQLite keeps files beside a GeoPackage: replacing it would mix two databases."""
    beside = next((path.with_name(path.name + end) for end in OPEN_ENDINGS if os.path.lexists(f"{path}{end}")), None)
    if beside is not None:
        raise ParameterError(
            f"{path} is open in another program, or was not closed by it (there is {beside.name}): close it, or name "
            "another file"
        )


def write_shapes(
    layers: Mapping[str, tuple[pd.DataFrame, np.ndarray, str]],
    path: str | Path,
    *,
    crs: str | None,
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Write layers of a GeoPackage: by name a table, its shapely shapes and their type, such as ``Point``.

    `facts` about the whole file are added with the aliases of fields.
    """
    system = None if crs is None else CRS.from_user_input(crs)
    written = [
        _layer(name, table, geometry=shapes, kind=kind, crs=system) for name, (table, shapes, kind) in layers.items()
    ]

    def write(place: Path) -> None:
        _write_layers(place, written)
        if facts is not None:
            add_tables(place, {}, date=_FIXED_DATE)
            add_metadata(place, facts, date=_FIXED_DATE)

    _write_whole(Path(path), write)


def points_of(table: pd.DataFrame) -> tuple[pd.DataFrame, np.ndarray, str]:
    """Return a table with `x` and `y` as a layer of points for `write_shapes`."""
    return table, np.asarray(shapely.points(table[["x", "y"]].to_numpy())), "Point"


def _write_whole(target: Path, fill: Callable[[Path], None]) -> None:
    """Write a GeoPackage by a function of its path, whole or not at all; equal content gives equal bytes."""

    def write(folder: Path) -> None:
        fill(folder / target.name)
        _check_whole(folder / target.name, target)

    with without_times():
        road_inventory.write_whole(target.parent, write)


def _check_whole(path: Path, target: Path) -> None:
    """Raise OSError if a layer lacks rows of its index, or tables and triggers: GDAL ignores some failed writes."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        sound = database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        # views have the index of their table
        real = "(SELECT name FROM sqlite_master WHERE type = 'table')"
        indexed = f"SELECT table_name FROM gpkg_geometry_columns WHERE table_name IN {real}"
        layers = [name for (name,) in database.execute(indexed)]
        parts, rows = set(), []
        for layer in layers:
            query = "SELECT count(*) FROM sqlite_master WHERE name LIKE ? OR (type = 'trigger' AND tbl_name = ?)"
            parts.add(database.execute(query, (f"rtree_{layer}_geom%", layer)).fetchone()[0])
            if not parts & {0}:
                tables = (f'"{layer}" WHERE geom IS NOT NULL', f"rtree_{layer}_geom")
                counts = [f"SELECT count(*) FROM {table}" for table in tables]
                rows.append(len({database.execute(count).fetchone() for count in counts}) == 1)
    if not (sound and len(parts) == 1 and 0 not in parts and all(rows)):
        raise OSError(errno.EIO, "a part of the GeoPackage was not written", str(target))


def _write_layers(path: Path, layers: Sequence[_Layer]) -> None:
    for layer in layers:
        with warnings.catch_warnings():
            # A survey may have no known CRS; GeoPackage has a code for it (-1, undefined Cartesian).
            warnings.filterwarnings("ignore", message=".*crs.* was not provided", category=UserWarning)
            # Version 1.2 is sufficient, and older releases of QGIS 3 warn about later ones.
            options = {} if path.exists() else {"VERSION": "1.2"}
            layer_options: dict[str, Any] = {"driver": "GPKG", "geometry_type": layer.kind, "append": path.exists()}
            pyogrio.write_dataframe(layer.rows, path, layer=layer.name, dataset_options=options, **layer_options)


def _layers(inventory: road_inventory.RoadInventory, table: pd.DataFrame, crs: CRS | None) -> list[_Layer]:
    """Return the layers in the order of the file."""
    columns, points = road_inventory.attributes(table), road_inventory.base_points(table)
    layers = [_layer("objects", columns, geometry=points, kind=_POINT, crs=crs)]
    layers.append(_footprints(table, crs))
    for name, kind in LINE_LAYERS.items():
        if inventory.lines is None:
            break
        of_kind = inventory.lines[inventory.lines["kind"] == kind]
        own = road_inventory.line_attributes(of_kind)[list(road_inventory.fields_of_layer(name))]
        layers.append(_layer(name, own, geometry=road_inventory.line_shapes(of_kind), kind=_LINE, crs=crs))
    if inventory.trajectory is not None:
        length, line = road_inventory.path_of(inventory.trajectory)
        layers.append(_layer("trajectory", length, geometry=line, kind=_LINE, crs=crs))
        if inventory.sections is not None:
            lines = np.array(
                [
                    shapely.LineString(part_of_path(inventory.trajectory, *ends))
                    for ends in inventory.sections[["from_station", "to_station"]].to_numpy()
                ]
            )
            layers.append(_layer("sections", inventory.sections, geometry=lines, kind=_LINE, crs=crs))
    for name, (rows, shapes, shape) in inventory.road.items():
        layers.append(_layer(name, rows, geometry=shapes, kind=shape, crs=crs))
    return layers


def _columns_of_kinds(table: pd.DataFrame) -> dict[str, list[str]]:
    """Return the columns of the layers of kinds: their fields, and notes and attributes that one of the kind has."""
    return {
        layer: [
            *road_inventory.fields_of_layer(layer),
            *(n for n in road_inventory.note_columns(table) if (table[n][table["kind"] == kind] != "").any()),
        ]
        for layer, kind in road_inventory.LAYERS.items()
    }


def _footprints(table: pd.DataFrame, crs: CRS | None) -> _Layer:
    shapes = road_inventory.hulls(table)
    present = ~shapely.is_missing(shapes)
    areas = [polygon_area(shapely.get_coordinates(shape)) for shape in shapes[present]]
    rows = table.loc[present, _OF_FOOTPRINTS].assign(area=np.round(np.array(areas, dtype=np.float64), 2))
    return _layer("footprints", rows, geometry=shapes[present], kind="Polygon", crs=crs)


def read_geopackage(path: str | Path) -> road_inventory.RoadInventory:
    """Read an inventory from a GeoPackage of `write_geopackage`."""
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such GeoPackage")
    try:
        layers = [str(name) for name in pyogrio.list_layers(source)[:, 0]]
    except pyogrio.errors.DataSourceError as error:
        raise ReadError(f"{source}: not a GeoPackage") from error
    for layer in ("objects", "footprints"):
        if layer not in layers:
            raise ReadError(f"{source}: no layer {layer!r} among {layers}")
    frame = gpd.read_file(source, layer="objects")
    missing = [name for name in FIELDS if name not in ("footprint", *road_inventory.DECIDED) and name not in frame]
    if missing:
        raise ReadError(f"{source}: layer 'objects' has no field {missing[0]!r}")
    trajectory = None
    if "trajectory" in layers:
        line = gpd.read_file(source, layer="trajectory").geometry.iloc[0]
        vertices = shapely.get_coordinates(line, include_z=True)
        trajectory = Trajectory.from_positions(vertices, source=str(source), check_jumps=False)
    sections = None
    if "sections" in layers:
        sections = pd.DataFrame(gpd.read_file(source, layer="sections").drop(columns="geometry"))
    # GDAL reads an undefined CRS as an engineering CRS of that name.
    known = frame.crs is not None and "Undefined" not in frame.crs.name
    crs = frame.crs.to_wkt() if known else None
    there = [name for name in LINE_LAYERS if name in layers]
    lines = numbered([_lines_of(source, name) for name in there]) if there else None
    return road_inventory.RoadInventory(_objects_of(source, frame), crs, trajectory, sections, lines)


def _lines_of(source: Path, layer: str) -> pd.DataFrame:
    frame = gpd.read_file(source, layer=layer)
    missing = [name for name in road_inventory.fields_of_layer(layer) if name not in frame and name not in ADDED_FIELDS]
    if missing:
        raise ReadError(f"{source}: layer {layer!r} has no field {missing[0]!r}")
    blank = {n: "" if field.dtype == "str" else np.nan for n, field in LINE_FIELDS.items()}
    frame = frame.assign(**{name: value for name, value in blank.items() if name not in frame})
    text = shapely.to_wkt(frame.geometry.to_numpy(), rounding_precision=3, trim=False)
    table = pd.DataFrame(frame.drop(columns="geometry")).assign(line=text, pattern=frame["pattern"].fillna(""))
    return table[list(LINE_FIELDS)].astype({name: field.dtype for name, field in LINE_FIELDS.items()})


def _objects_of(source: Path, frame: gpd.GeoDataFrame) -> pd.DataFrame:
    shapes = gpd.read_file(source, layer="footprints")
    text = road_inventory.footprint_text(shapes.geometry.to_numpy())
    outlines = frame["object_id"].map(dict(zip(shapes["object_id"], text, strict=True))).astype(object).fillna("")
    return road_inventory.with_empty_text(frame.drop(columns="geometry").assign(footprint=outlines))
