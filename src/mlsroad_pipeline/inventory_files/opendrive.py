"""Road inventory as OpenDRIVE 1.7: objects, signals and lines beside a road along the path of the scanner."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import ProjError

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.arcs import ArcLine, spread
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, checked, line_vertices, note_columns

logger = logging.getLogger(__name__)

OBJECT_TYPES = {"pole": "pole", "tree": "tree", "vehicle": "obstacle"}
"""Kind to type of an object; signs are signals."""

LINE_TYPES = {
    "kerb": "barrier", "wire": "obstacle", "barrier": "barrier", "lane_line": "roadMark", "stop_line": "roadMark",
    "crossing": "crosswalk", "other_marking": "roadMark",
}  # fmt: skip
"""Kind of a line to type of an object with an open outline."""

_SPACING = 5.0  # of the positions of the path that the road leads through, metres
_BESIDE = 15.0  # largest distance of the objects that give the height of the road, metres
_LANE = "1.0"  # width of the one lane that the format demands; its type is `none`
_DATA = ("key", "class", "score", "status", "point_count")


class _Road(NamedTuple):
    """Reference line, and the heights of the road at its nodes."""

    line: ArcLine
    heights: NDArray[np.float64]

    def place(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return s, t and the height above the reference line of places, (n, 3)."""
        way, side = self.line.locate(xyz[:, :2])
        return np.column_stack([way, side, xyz[:, 2] - self.height(way)])

    def height(self, way: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height of the reference line."""
        found: NDArray[np.float64] = np.interp(way, self.line.nodes, self.heights)
        return found


def write_opendrive(inventory: RoadInventory, target: Path) -> None:
    """Write an inventory as OpenDRIVE (``.xodr``); DataError without a path, which gives the road.

    The road leads through positions of the path every 5 m. Its height is that of the path, lowered by the median height
    of the path above the bases of the objects beside it.
    """
    table, crs = checked(inventory, target)
    if inventory.trajectory is None:
        raise DataError(f"{target}: OpenDRIVE places objects along a road, and the survey has no path of the scanner")
    lines = pd.DataFrame() if inventory.lines is None else inventory.lines
    vertices = line_vertices(lines) if len(lines) else []
    road = _road(inventory.trajectory.xyz, table, vertices)
    root = ET.Element("OpenDRIVE")
    corners = np.vstack([inventory.trajectory.xyz[:, :2], table[["x", "y"]].to_numpy(), *(v[:, :2] for v in vertices)])
    _add_header(root, crs, corners, target)
    node = _child(root, "road", name="path of the scanner", length=_metres(road.line.length), id="1", junction="-1")
    _add_road(node, road)
    objects = _child(node, "objects")
    signals = _child(node, "signals")
    placed = road.place(table[["x", "y", "z"]].to_numpy())
    headings = road.line.at(placed[:, 0])[1]
    for row, (s, t, z), heading in zip(table.to_dict("records"), placed.tolist(), headings.tolist(), strict=True):
        item = {str(name): value for name, value in row.items()}
        where = {"s": _metres(s), "t": _metres(t), "zOffset": _metres(z)}
        is_sign = item["kind"] == "sign"
        made = (_add_signal if is_sign else _add_object)(signals if is_sign else objects, item, where, heading)
        _add_data(made, item, (*_DATA, *note_columns(table)))
    for row, corners_of_line in zip(lines.to_dict("records"), vertices, strict=True):
        _add_line(objects, {str(name): value for name, value in row.items()}, road.place(corners_of_line))
    ET.indent(root)
    write_atomic(target, ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _child(node: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(node, tag, attributes)


def _road(path: NDArray[np.float64], table: pd.DataFrame, vertices: list[NDArray[np.float64]]) -> _Road:
    places = np.vstack([table[["x", "y"]].to_numpy(), *(line[:, :2] for line in vertices)])
    nodes = path[spread(path[:, :2], _SPACING)]
    line = ArcLine.beside(nodes[:, :2], places)
    road = _Road(line, nodes[:, 2])
    s_t_z = road.place(table[["x", "y", "z"]].to_numpy())
    above = s_t_z[np.abs(s_t_z[:, 1]) <= _BESIDE, 2]
    return road if not len(above) else road._replace(heights=road.heights + np.median(above))


def _add_header(root: ET.Element, crs: CRS | None, corners: NDArray[np.float64], target: Path) -> None:
    (west, south), (east, north) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    limits = {"north": north, "south": south, "east": east, "west": west}
    header = _child(
        root, "header", revMajor="1", revMinor="7", vendor="mlsroad", **{name: _metres(v) for name, v in limits.items()}
    )
    text = "" if crs is None else _proj_text(crs)
    if text:
        _child(header, "geoReference").text = text
    else:
        name = "none" if crs is None else repr(crs.name)
        logger.warning("%s has no geoReference: the coordinate reference system is %s", target.name, name)


def _proj_text(crs: CRS) -> str:
    """Return a coordinate reference system as PROJ text; empty if it has none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # names are lost
            return str(crs.to_proj4()).replace(" +type=crs", "")
    except ProjError:
        return ""


def _add_road(node: ET.Element, road: _Road) -> None:
    """Add the course, the heights and the one lane."""
    view, line = _child(node, "planView"), road.line
    rows = zip(line.starts.tolist(), *(column.tolist() for column in line.pieces), strict=True)
    for s, (x, y), heading, curvature, length in rows:
        piece = _child(
            view, "geometry", s=_metres(s), x=_metres(x), y=_metres(y), hdg=_exact(heading), length=_metres(length)
        )
        if curvature:
            _child(piece, "arc", curvature=_exact(curvature))
        else:
            _child(piece, "line")
    profile = _child(node, "elevationProfile")
    slopes = [0.0, *(np.diff(road.heights) / np.diff(line.nodes)).tolist(), 0.0]
    records = zip([0.0, *line.nodes.tolist()], [road.heights[0], *road.heights], slopes, strict=True)
    for s, height, slope in list(records)[int(line.nodes[0] == 0.0) :]:
        _child(profile, "elevation", s=_metres(s), a=_metres(height), b=_exact(slope), c="0", d="0")
    section = _child(_child(node, "lanes"), "laneSection", s="0")
    _child(_child(section, "center"), "lane", id="0", type="none", level="false")
    lane = _child(_child(section, "right"), "lane", id="-1", type="none", level="false")
    _child(lane, "width", sOffset="0", a=_LANE, b="0", c="0", d="0")


def _add_object(node: ET.Element, row: Mapping[str, Any], where: Mapping[str, str], heading: float) -> ET.Element:
    sizes = {"height": row["height"]}
    if row["kind"] == "vehicle":
        sizes |= {"length": row["length"], "width": row["width"]}
    else:
        sizes["radius"] = (row["crown_diameter"] if row["kind"] == "tree" else row["diameter"]) / 2.0
    turned = _turned(row["heading"], heading) if row["kind"] == "vehicle" else {}
    kind = {"type": OBJECT_TYPES[row["kind"]], "subtype": row["kind"], "name": row["class"], "orientation": "none"}
    return _child(node, "object", id=str(row["object_id"]), **kind, **where, **_sizes(sizes), **turned)


def _add_signal(node: ET.Element, row: Mapping[str, Any], where: Mapping[str, str], heading: float) -> ET.Element:
    """Add a sign; the direction in which it is valid is opposite to that of its front."""
    given = {"dynamic": "no", "type": "-1", "subtype": "-1", "name": row["class"], "orientation": "none"}
    turned = _turned(row["facing"] + 180.0, heading)
    if turned and row["facing_from"] != "unknown":
        offset = float(turned["hdg"])
        forward = abs(offset) <= np.pi / 2
        given["orientation"] = "+" if forward else "-"
        turned = {"hdg": _exact(offset if forward else _wrapped(offset - np.pi))}
    direction = {"hOffset": turned["hdg"]} if turned else {}
    bottom = 0.0 if np.isnan(row["panel_bottom"]) else float(row["panel_bottom"])
    where = {**where, "zOffset": _metres(float(where["zOffset"]) + bottom)}
    sizes = _sizes({"height": row["panel_height"], "width": row["panel_width"]})
    made = _child(node, "signal", id=str(row["object_id"]), **given, **where, **direction, **sizes)
    if row["pole_id"]:
        _child(made, "reference", elementType="object", elementId=str(row["pole_id"]))
    return made


def _add_line(node: ET.Element, row: Mapping[str, Any], corners: NDArray[np.float64]) -> None:
    (s, t, z), kind = corners[0].tolist(), str(row["kind"])
    made = _child(
        node, "object", id=f"line_{row['line_id']}", type=LINE_TYPES[kind], subtype=kind, name=kind,
        s=_metres(s), t=_metres(t), zOffset=_metres(z), orientation="none",
    )  # fmt: skip
    outline = _child(_child(made, "outlines"), "outline", id="0", closed="false")
    height = _metres(row["height"]) if row["height"] > 0 else "0"
    for number, (s, t, z) in enumerate(corners.tolist()):
        _child(outline, "cornerRoad", id=str(number), s=_metres(s), t=_metres(t), dz=_metres(z), height=height)
    _add_data(made, row, ("score", "width", "pattern"))


def _add_data(node: ET.Element, row: Mapping[str, Any], names: Iterable[str]) -> None:
    """Add columns of the inventory that the format has no attribute for."""
    for name in names:
        value = row.get(name)
        if value is not None and value != "" and not pd.isna(value):
            _child(node, "userData", code=name, value=str(value))


def _sizes(sizes: Mapping[str, float]) -> dict[str, str]:
    """Return measures as attributes; those that are unknown are left out."""
    return {name: _metres(value) for name, value in sizes.items() if value >= 1e-4}


def _turned(azimuth: float, heading: float) -> dict[str, str]:
    """Return an azimuth in degrees as heading relative to the road; none where it is unknown."""
    return {} if np.isnan(azimuth) else {"hdg": _exact(_wrapped(np.pi / 2 - np.radians(azimuth) - heading))}


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _metres(value: float) -> str:
    return f"{value:.4f}"


def _exact(value: float) -> str:
    return f"{value:.12g}"
