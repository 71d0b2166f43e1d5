"""Road inventory as a DXF drawing for CAD programs."""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from ezdxf import options, units  # type: ignore[attr-defined]  # documented, but not marked as exported
from ezdxf.document import Drawing
from ezdxf.filemanagement import new
from ezdxf.layouts.blocklayout import BlockLayout
from ezdxf.layouts.layout import Modelspace
from pyproj import CRS

from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.qgis_styles import COLOURS, LINE_COLOURS
from mlsroad_pipeline.inventory_files.road_inventory import (
    Layer,
    RoadInventory,
    checked,
    hulls,
    line_vertices,
    note_columns,
)
from mlsroad_pipeline.inventory_files.vector_files import crs_name, write_prj

VERSION = "R2010"
APPLICATION = "MLSROAD"
"""Name under which outlines hold the number of their object, as extended data of group code 1071."""

ATTRIBUTES = (
    "object_id", "class", "kind", "score", "height", "width", "length", "heading", "tilt", "lean_azimuth", "pole_type",
    "diameter", "crown_diameter", "panel_bottom", "panel_centre", "panel_height", "panel_width", "panel_shape",
    "facing", "facing_from", "clearance", "station", "offset", "pole_id", "point_count", "reasons",
)  # fmt: skip
"""Fields that are attributes of the blocks; those that an object lacks are left out."""

_TEXT_HEIGHT = 0.2  # of attributes and measures, metres
_ROAD_COLOUR = (200, 80, 30)
_FORBIDDEN = re.compile(r"[<>/\\\":;?*|=,`]")


@contextmanager
def without_dates() -> Iterator[None]:
    """Write drawings without times and random numbers: equal inventories give equal bytes."""
    before = options.write_fixed_meta_data_for_testing
    options.write_fixed_meta_data_for_testing = True
    try:
        yield
    finally:
        options.write_fixed_meta_data_for_testing = before


def layer_name(kind: str, name: str) -> str:
    """Return the layer of a class: its name, after its kind where that is another word."""
    whole = name if name == kind else f"{kind}_{name}"
    return _FORBIDDEN.sub("_", whole)


def _add_blocks(doc: Drawing, names: Sequence[str]) -> None:
    """Add a block per symbol: unit sizes, the direction towards +y."""
    pole = doc.blocks.new("POLE")
    pole.add_circle((0, 0), 0.15)
    sign = doc.blocks.new("SIGN")
    sign.add_lwpolyline([(-0.4, -0.2), (0.4, -0.2), (0, 0.5)], close=True)
    plain = doc.blocks.new("SIGN_PLAIN")  # without a measured panel
    plain.add_lwpolyline([(0, -0.4), (0.4, 0), (0, 0.4), (-0.4, 0)], close=True)
    board = doc.blocks.new("SIGN_BOTH")  # of unknown front
    board.add_line((-0.4, 0), (0.4, 0))
    board.add_line((0, -0.2), (0, 0.2))
    tree = doc.blocks.new("TREE")
    tree.add_circle((0, 0), 0.5)
    tree.add_point((0, 0))
    vehicle = doc.blocks.new("VEHICLE")
    vehicle.add_lwpolyline([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)], close=True)
    for block in (pole, sign, plain, board, tree, vehicle):
        _define(block, names)


def _define(block: BlockLayout, names: Sequence[str]) -> None:
    for name in names:
        block.add_attdef(name.upper(), (0, 0), dxfattribs={"height": _TEXT_HEIGHT, "flags": 1})


def _placed(row: dict[str, Any]) -> tuple[str, dict[str, float]]:
    """Return the block of an object, and its rotation (counterclockwise) and scale."""
    if row["kind"] == "sign":
        name = {"": "SIGN_PLAIN", "unknown": "SIGN_BOTH"}.get(row["facing_from"], "SIGN")
        return name, {"rotation": -float(np.nan_to_num(row["facing"]))}
    if row["kind"] == "tree":
        crown = row["crown_diameter"] if row["crown_diameter"] > 0 else max(row["width"], 0.1)
        return "TREE", {"xscale": crown, "yscale": crown}
    if row["kind"] == "vehicle":
        return "VEHICLE", {"rotation": -row["heading"], "xscale": row["width"], "yscale": row["length"]}
    return "POLE", {}


def _add_object(space: Modelspace, row: dict[str, Any], names: Sequence[str]) -> None:
    block, place = _placed(row)
    layer, base = layer_name(row["kind"], row["class"]), (row["x"], row["y"], row["z"])
    reference = space.add_blockref(block, base, dxfattribs={"layer": layer, **place})
    for name in names:
        value = row[name]
        if value == "" or pd.isna(value):
            continue
        attribute = reference.add_attrib(name.upper(), str(value), base, {"layer": layer, "height": _TEXT_HEIGHT})
        attribute.is_invisible = True


def _add_outlines(space: Modelspace, table: pd.DataFrame) -> None:
    """Add the footprints as closed polylines at the height of the base."""
    for row, shape in zip(table.to_dict("records"), hulls(table), strict=True):
        if shape is None:
            continue
        corners = shapely.get_coordinates(shape)[:-1]
        attributes = {"layer": f"{layer_name(row['kind'], row['class'])}_footprint", "elevation": row["z"]}
        outline = space.add_lwpolyline(corners, format="xy", close=True, dxfattribs=attributes)
        outline.set_xdata(APPLICATION, [(1071, row["object_id"])])


def _add_layers(doc: Drawing, table: pd.DataFrame) -> None:
    for kind in KINDS:
        red, green, blue = (int(part) for part in COLOURS[kind].split(","))
        for name in sorted(set(table.loc[table["kind"] == kind, "class"])):
            for layer in (layer_name(kind, name), f"{layer_name(kind, name)}_footprint"):
                if layer not in doc.layers:
                    doc.layers.add(layer).rgb = (red, green, blue)


def _add_lines(doc: Drawing, space: Modelspace, lines: pd.DataFrame) -> None:
    """Add lines as 3D polylines, in a layer per kind."""
    for kind in sorted(set(lines["kind"])):
        red, green, blue = (int(part) for part in LINE_COLOURS[kind].split(","))
        doc.layers.add(kind).rgb = (red, green, blue)
    for kind, number, vertices in zip(lines["kind"], lines["line_id"], line_vertices(lines), strict=True):
        line = space.add_polyline3d(vertices.tolist(), dxfattribs={"layer": kind})
        line.set_xdata(APPLICATION, [(1071, int(number))])


def _add_road(doc: Drawing, space: Modelspace, road: Mapping[str, Layer]) -> None:
    """Add sections, widths and sight as 3D polylines, and places inside the envelope as points with their measure."""
    for name, (rows, shapes, _) in road.items():
        if name == "road":  # its parts are those of the sections
            continue
        attributes = {"layer": name}
        doc.layers.add(name).rgb = _ROAD_COLOUR
        for row, shape in zip(rows.to_dict("records"), shapes, strict=True):
            places = shapely.get_coordinates(shape, include_z=True).tolist()
            if len(places) > 1:
                space.add_polyline3d(places, dxfattribs=attributes)
                continue
            space.add_point(places[0], dxfattribs=attributes)
            text = f"{row['state']} {row['height']:.2f} m"
            space.add_text(text, height=_TEXT_HEIGHT, dxfattribs=attributes).set_placement(places[0])


def _drawn(inventory: RoadInventory, table: pd.DataFrame, crs: CRS | None) -> Drawing:
    doc = new(VERSION, units=units.M)
    doc.appids.add(APPLICATION)
    doc.header.custom_vars.append("CRS", crs_name(crs) or "unknown")
    _add_layers(doc, table)
    names = (*ATTRIBUTES, *note_columns(table))
    _add_blocks(doc, names)
    space = doc.modelspace()
    for row in table.to_dict("records"):
        _add_object(space, {str(name): value for name, value in row.items()}, names)
    _add_outlines(space, table)
    if inventory.lines is not None:
        _add_lines(doc, space, inventory.lines)
    if inventory.trajectory is not None:
        doc.layers.add("trajectory").rgb = (130, 60, 160)
        space.add_polyline3d(inventory.trajectory.xyz.tolist(), dxfattribs={"layer": "trajectory"})
    _add_road(doc, space, inventory.road)
    if len(table):
        doc.header["$EXTMIN"] = tuple(table[["x_min", "y_min", "z_min"]].min())
        doc.header["$EXTMAX"] = tuple(table[["x_max", "y_max", "z_max"]].max())
    return doc


def write_dxf(inventory: RoadInventory, folder: Path) -> list[Path]:
    """Write ``inventory.dxf`` (AutoCAD 2010): blocks with attributes, outlines, lines, path, road; and its ``.prj``.

    Layers are named after the classes. Blocks lie at the base points with their elevations. The drawing is in metres;
    its custom property `CRS` names the coordinate reference system.
    """
    target = folder / "inventory.dxf"
    table, crs = checked(inventory, target)
    text = io.StringIO()
    with without_dates():
        doc = _drawn(inventory, table, crs)
        doc.write(text)
    write_atomic(target, doc.encode(text.getvalue()))
    return [target, *write_prj(crs, target.with_suffix(".prj"))]
