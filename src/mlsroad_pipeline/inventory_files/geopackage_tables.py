"""Tables of a GeoPackage with field aliases and QGIS styles."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_LAYERS
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS

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
            fields = LINE_FIELDS if layer in LINE_LAYERS else FIELDS
            rows = [(layer, n, fields[n].alias, fields[n].alias, fields[n].description) for n in names if n in fields]
            base.executemany(
                "INSERT INTO gpkg_data_columns (table_name, column_name, name, title, description)"
                " VALUES (?, ?, ?, ?, ?)",
                rows,
            )
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
