"""Layers of the kinds of a GeoPackage as views of its table `objects`: an edit in one reaches the other."""

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

import shapely
from numpy.typing import NDArray

from mlsroad_pipeline.inventory_files.road_inventory import LAYERS

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
