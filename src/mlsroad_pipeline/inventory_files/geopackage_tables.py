"""Tables of a GeoPackage beside its layers (aliases, value lists, styles, metadata), and layers as views."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mlsroad_pipeline import __version__
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS
from mlsroad_pipeline.algorithms.inventory.road.places import PLACE_FIELDS
from mlsroad_pipeline.algorithms.inventory.road.sight import SIGHT_FIELDS
from mlsroad_pipeline.algorithms.inventory.road.table import ROAD_FIELDS, ROAD_LAYERS
from mlsroad_pipeline.inventory_files.road_inventory import LAYERS, RoadInventory, is_note, note_field

_SCHEMA_EXTENSION = """
CREATE TABLE gpkg_data_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, name TEXT, title TEXT, description TEXT, mime_type TEXT,
  constraint_name TEXT, CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name),
  CONSTRAINT gdc_tn UNIQUE (table_name, name));
CREATE TABLE gpkg_data_column_constraints (
  constraint_name TEXT NOT NULL, constraint_type TEXT NOT NULL, value TEXT, min NUMERIC, min_is_inclusive BOOLEAN,
  max NUMERIC, max_is_inclusive BOOLEAN, description TEXT,
  CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value));
CREATE TABLE IF NOT EXISTS gpkg_extensions (
  table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL, definition TEXT NOT NULL, scope TEXT NOT NULL,
  CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name));
"""
_EXTENSION = ("gpkg_schema", "http://www.geopackage.org/spec121/#extension_schema", "read-write")

# Table and column names under which QGIS looks up the style of a layer.
_LAYER_STYLES = """
CREATE TABLE layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256), f_table_schema TEXT(256),
  f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT,
  useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30), update_time DATETIME);
"""

FIELDS_OF_ROAD = {**dict.fromkeys(ROAD_LAYERS, ROAD_FIELDS), "intrusions": PLACE_FIELDS, "sight": SIGHT_FIELDS}
"""Layer of a road to its columns; those of sections are medians of the same names, and others."""


def add_tables(path: Path, styles: Mapping[str, str], *, date: str) -> None:
    """Add field aliases (extension Schema) and layer styles (QML, by layer) to a GeoPackage without these tables.

    `date` is the time of the last change, ISO 8601 in UTC. Styles of absent layers are skipped.
    """
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("PRAGMA synchronous = OFF")  # the finished file is synced
        base.execute("PRAGMA journal_mode = MEMORY")
        layers = dict(base.execute("SELECT table_name, column_name FROM gpkg_geometry_columns").fetchall())
        base.executescript(_SCHEMA_EXTENSION)
        for table in ("gpkg_data_columns", "gpkg_data_column_constraints"):
            base.execute("INSERT INTO gpkg_extensions VALUES (?, NULL, ?, ?, ?)", (table, *_EXTENSION))
        for layer in layers:
            # The argument of a pragma cannot be bound; the layer names are constants of this package.
            names = [row[1] for row in base.execute(f'PRAGMA table_info("{layer}")')]
            special = {**dict.fromkeys(LINE_LAYERS, LINE_FIELDS), **FIELDS_OF_ROAD}
            fields = special.get(layer, FIELDS)
            known = {n: fields[n] if n in fields else note_field(n) for n in names if n in fields or is_note(n)}
            lists = {n: f"{layer}_{n}" for n, field in known.items() if field.values}
            rows = [(layer, n, f.alias, f.alias, f.description, lists.get(n)) for n, f in known.items()]
            base.executemany(
                "INSERT INTO gpkg_data_columns (table_name, column_name, name, title, description, constraint_name)"
                " VALUES (?, ?, ?, ?, ?, ?)",
                rows,
            )
            base.executemany(
                "INSERT INTO gpkg_data_column_constraints (constraint_name, constraint_type, value)"
                " VALUES (?, 'enum', ?)",
                [(name, value) for n, name in lists.items() for value in known[n].values],
            )
            words = (DESCRIPTIONS.get(layer, ""), layer)
            base.execute("UPDATE gpkg_contents SET description = ? WHERE table_name = ?", words)
        base.executescript(_LAYER_STYLES)
        for layer, style in styles.items():
            if layer in layers:
                base.execute(
                    "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column,"
                    " styleName, styleQML, styleSLD, useAsDefault, description, owner, ui, update_time)"
                    " VALUES ('', '', ?, ?, ?, ?, '', 1, 'Road inventory', '', NULL, ?)",
                    (layer, layers[layer], layer, style, date),
                )
        base.execute(
            "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, last_change, srs_id)"
            " VALUES ('layer_styles', 'attributes', 'layer_styles', '', ?, 0)",
            (date,),
        )


DESCRIPTIONS = {
    "objects": "All objects; the layers of kinds are views of them with the columns of their kind.",
    **{name: f"Objects of kind {kind}." for name, kind in LAYERS.items()},
    "footprints": "Convex hulls of the points of objects.",
    **{name: f"Lines of kind {kind}." for name, kind in LINE_LAYERS.items()},
    "trajectory": "Path of the scanner.",
    "sections": "Sections of the road, with the objects and lines in them.",
    "road": "Measures of the road per metre of the path.",
    "road_widths": "Lines across the carriageway from edge to edge.",
    "road_sections": "Medians, least width and clearance per section of the road.",
    "intrusions": "Lowest points inside the envelope, and below the least clearance.",
    "sight": "Ways on which a sign is seen uninterrupted.",
}
"""Layer to its description."""

_METADATA = """
CREATE TABLE gpkg_metadata (
  id INTEGER CONSTRAINT m_pk PRIMARY KEY ASC NOT NULL, md_scope TEXT NOT NULL DEFAULT 'dataset',
  md_standard_uri TEXT NOT NULL, mime_type TEXT NOT NULL DEFAULT 'text/xml', metadata TEXT NOT NULL DEFAULT '');
CREATE TABLE gpkg_metadata_reference (
  reference_scope TEXT NOT NULL, table_name TEXT, column_name TEXT, row_id_value INTEGER,
  timestamp DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')), md_file_id INTEGER NOT NULL,
  md_parent_id INTEGER);
"""


def add_metadata(path: Path, facts: Mapping[str, Any], *, date: str) -> None:
    """Add facts about the whole file, as JSON, to a GeoPackage with the tables of `add_tables` (extension Metadata)."""
    definition = "http://www.geopackage.org/spec121/#extension_metadata"
    with closing(sqlite3.connect(path)) as base, base:
        base.executescript(_METADATA)
        for table in ("gpkg_metadata", "gpkg_metadata_reference"):
            row = (table, "gpkg_metadata", definition, "read-write")
            base.execute("INSERT INTO gpkg_extensions VALUES (?, NULL, ?, ?, ?)", row)
        text = json.dumps(facts, sort_keys=True)
        base.execute(
            "INSERT INTO gpkg_metadata VALUES (1, 'dataset', 'https://schema.org', 'application/json', ?)", (text,)
        )
        base.execute("INSERT INTO gpkg_metadata_reference VALUES ('geopackage', NULL, NULL, NULL, ?, 1, NULL)", (date,))


def metadata_of(inventory: RoadInventory) -> dict[str, Any]:
    """Return the facts about an inventory: program, models, and when and along which way the survey was driven."""
    objects, path = inventory.objects, inventory.trajectory
    models = sorted({" ".join(pair).strip() for pair in objects[["method", "model_version"]].to_numpy().tolist()})
    times = objects[["first_time", "last_time"]].to_numpy(dtype=np.float64)
    seen = {"gpsTime": [float(np.nanmin(times)), float(np.nanmax(times))]} if np.isfinite(times).any() else {}
    way = {} if path is None else {"trajectoryMetres": round(float(path.length), 1)}
    return {"creator": f"mlsroad {__version__}", "models": models, **seen, **way}


BOXES = "vehicle_boxes"
"""Table with the boxes of vehicles, by row of `objects`; GDAL and QGIS show it as the shapes of `vehicles` alone."""


def _quoted(names: Sequence[str], prefix: str = "") -> list[str]:
    return [prefix + '"' + name.replace('"', '""') + '"' for name in names]


def view_sql(layer: str, columns: Sequence[str]) -> str:
    """Return the statement that makes the view of a kind with columns of `objects`."""
    fields = ", ".join(f"{own} AS {name}" for own, name in zip(_quoted(columns, "o."), _quoted(columns), strict=True))
    shape = "b.geom" if layer == "vehicles" else "o.geom"
    boxes = f" LEFT JOIN {BOXES} b ON b.object_fid = o.fid" if layer == "vehicles" else ""
    return (
        f"CREATE VIEW {layer} AS SELECT o.fid AS fid, {shape} AS geom, {fields} FROM objects o{boxes} "
        f"WHERE o.kind = '{LAYERS[layer]}'"
    )


def _triggers(layer: str, columns: Sequence[str]) -> list[str]:
    """Return the statements by which rows of a view are changed, deleted and added in its tables."""
    has_box = layer == "vehicles"
    names = [*([] if has_box else ["geom"]), *columns]
    kind = f"coalesce(nullif(NEW.kind, ''), '{LAYERS[layer]}')"
    values = [kind if name == "kind" else new for name, new in zip(names, _quoted(names, "NEW."), strict=True)]
    pairs = ", ".join(f"{n} = {new}" for n, new in zip(_quoted(names), _quoted(names, "NEW."), strict=True))
    box = f"INSERT OR REPLACE INTO {BOXES} VALUES ({{}}, NEW.geom);" if has_box else ""
    gone = f"DELETE FROM {BOXES} WHERE object_fid = OLD.fid;" if has_box else ""
    actions = {
        "UPDATE": f"UPDATE objects SET {pairs} WHERE fid = OLD.fid; {box.format('OLD.fid')}",
        "DELETE": f"DELETE FROM objects WHERE fid = OLD.fid; {gone}",
        "INSERT": f"INSERT INTO objects ({', '.join(_quoted(names))}) VALUES ({', '.join(values)}); "
        + box.format("last_insert_rowid()"),
    }
    return [
        f"CREATE TRIGGER {layer}_{event.lower()} INSTEAD OF {event} ON {layer} BEGIN {action} END"
        for event, action in actions.items()
    ]


def add_views(path: Path, columns: Mapping[str, Sequence[str]], boxes: NDArray, *, date: str) -> None:
    """Add the layers of the kinds, by name their columns, to a GeoPackage with `objects`.

    `boxes` has the shape of each row of `objects`, None where it has none.
    """
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("PRAGMA synchronous = OFF")  # the finished file is synced
        query = "SELECT srs_id FROM gpkg_geometry_columns WHERE table_name = 'objects'"
        (system,) = base.execute(query).fetchone()
        base.execute(f"CREATE TABLE {BOXES} (object_fid INTEGER PRIMARY KEY, geom POLYGON)")
        head = b"GP\x00\x01" + int(system).to_bytes(4, "little", signed=True)  # version 1, no envelope
        fids = [fid for (fid,) in base.execute("SELECT fid FROM objects ORDER BY fid")]
        shapes = shapely.to_wkb(boxes, output_dimension=3, byte_order=1, flavor="iso")
        rows = [(fid, head + shape) for fid, shape in zip(fids, shapes, strict=True) if shape is not None]
        base.executemany(f"INSERT INTO {BOXES} VALUES (?, ?)", rows)
        for layer, names in columns.items():
            for statement in (view_sql(layer, names), *_triggers(layer, names)):
                base.execute(statement)
            base.execute(
                "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, last_change, srs_id)"
                " VALUES (?, 'features', ?, '', ?, ?)",
                (layer, layer, date, system),
            )
            shape = "POLYGON" if layer == "vehicles" else "POINT"
            base.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 1, 0)", (layer, shape, system))


def own_views(base: sqlite3.Connection) -> set[str]:
    """Return the layers of kinds that are the views of `add_views`, where `objects` is a table."""
    tables = dict(base.execute("SELECT name, type FROM sqlite_master WHERE name IN ('objects', ?)", (BOXES,)))
    if tables != {"objects": "table", BOXES: "table"}:
        return set()
    found = base.execute("SELECT name, sql FROM sqlite_master WHERE type = 'view'").fetchall()
    known = {"fid", "geom"}
    return {
        name
        for name, sql in found
        if name in LAYERS
        and sql == view_sql(name, [row[1] for row in base.execute(f"PRAGMA table_info({name})") if row[1] not in known])
    }
