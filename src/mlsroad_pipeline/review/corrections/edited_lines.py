"""Decisions about lines from a GeoPackage that was edited in another program: moved, cut, joined, deleted, new."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS, LINE_LAYERS
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.review.corrections.decisions import FARTHEST, Correction, Decision
from mlsroad_pipeline.review.corrections.edited_layers import far_away, read_line_layers
from mlsroad_pipeline.review.corrections.line_decisions import line_states

MOVED = 0.01
"""Least distance in plan or height at which a vertex counts as moved, metres."""

_ZERO = 1.0  # height of the ground from which a height of 0 is none, metres


@dataclass
class _Line:
    """Line of the inventory."""

    number: int
    kind: str
    now: NDArray[np.float64]
    # As it was labelled; None for lines that decisions have made
    listed: NDArray[np.float64] | None = None
    listed_kind: str = ""
    is_rejected: bool = False
    is_gone: bool = False  # joined to another one
    is_there: bool = False  # has a row in the file

    @property
    def named(self) -> dict[str, Any]:
        """Return how a decision names the line."""
        return {"line": self.number, "x": float(self.now[0, 0]), "y": float(self.now[0, 1])}


@dataclass
class _Row:
    """Row of a layer."""

    number: int | None
    kind: str
    vertices: NDArray[np.float64]


@dataclass
class _Edits:
    """Lines of an inventory, and the corrections that were found so far."""

    lines: dict[int, _Line]
    ground: NDArray[np.float64]  # Places whose heights new vertices take
    found: list[Correction] = field(default_factory=list)
    drawn: list[list[float]] = field(default_factory=list)  # Vertices of edited rows in plan
    n_without_height: int = 0

    @property
    def last(self) -> int:
        """Return the largest number of a line."""
        return max(self.lines, default=0)

    def line_of(self, row: _Row) -> _Line | None:
        """Return the line that a row is as it is now."""
        present = (line for line in self.lines.values() if line.kind == row.kind and not line.is_gone)
        return next((line for line in present if _same(row.vertices, line.now)), None)


def corrections_of_lines(
    path: Path, folder: Path, decisions: Sequence[Decision], *, system: CRS | None, many_deleted: bool = False
) -> tuple[list[Correction], list[str]]:
    """Return the decisions about lines that an edited GeoPackage holds and the store does not, and what was not read.

    A row that is as it was labelled, or as it is after `decisions`, is no edit. Rows of one number that follow each
    other are a cut line; a missing line that lies on a changed one was joined to it.
    """
    notes: list[str] = []
    layers = read_line_layers(path, system, notes)
    source = folder / "inventory.gpkg"
    inventory = read_geopackage(source) if layers and source.is_file() else None
    if inventory is None or inventory.lines is None:
        return [], [*notes, *([f"{len(layers)} layers of lines: the inventory has no lines"] if layers else [])]
    edits = _Edits(_lines_of(inventory, inventory.lines, decisions), _heights(inventory, inventory.lines))
    rows = [row for name, frame in layers.items() for row in _rows(path, name, frame, edits.lines, notes)]
    changed = _without_known(edits, rows)
    missing = _missing(edits, {LINE_LAYERS[name] for name in layers})
    for number in dict.fromkeys(row.number for row in changed if row.number is not None):
        _edit(path, edits, edits.lines[number], [row for row in changed if row.number == number], missing)
    for row in changed:
        if row.number is None:
            edits.found.append(Correction("add_line", kind=row.kind, payload={"parts": [_with_heights(edits, row)]}))
    n_listed = sum(line.listed is not None for line in edits.lines.values())
    if len(missing) > max(n_listed / 2, 1) and not many_deleted:
        raise DataError(
            f"{path} lacks {len(missing)} of {n_listed} lines, which would be rejected: is it whole? --many-deleted "
            "accepts it"
        )
    rejected = [Correction("reject_line", kind=line.kind, payload=line.named) for line in missing.values()]
    if edits.n_without_height:
        notes.append(f"{edits.n_without_height} vertices of lines have no height, or 0: that beside them is taken")
    notes += far_away("vertices of lines", edits.drawn, edits.ground)
    return [*edits.found, *rejected], notes


def _lines_of(inventory: RoadInventory, lines: pd.DataFrame, decisions: Sequence[Decision]) -> dict[int, _Line]:
    states = line_states(decisions, lines, inventory.trajectory)
    columns = ["line_id", "kind", "line"]
    found = {}
    for number, kind, text in lines[columns].itertuples(index=False):
        own = _vertices(shapely.from_wkt(text))
        found[number] = _Line(number, kind, own, own, kind, is_gone=number in states.gone)
    for number, kind, text in states.apply(lines)[columns].itertuples(index=False):
        now = _vertices(shapely.from_wkt(text))
        found.setdefault(number, _Line(number, kind, now))
        found[number].kind, found[number].now = kind, now
        found[number].is_rejected = states.status.get(number) == "rejected"
    return found


def _heights(inventory: RoadInventory, lines: pd.DataFrame) -> NDArray[np.float64]:
    bases = inventory.objects[["x", "y", "z"]].dropna().to_numpy(np.float64)
    corners = [_vertices(shape) for shape in shapely.from_wkt(lines["line"].to_numpy(object))]
    return np.vstack([bases, *corners])


def _rows(
    path: Path, layer: str, frame: gpd.GeoDataFrame, lines: Mapping[int, _Line], notes: list[str]
) -> Iterator[_Row]:
    """Yield the rows of a layer; those without a line that can be read are named in `notes`."""
    unread, strange = [], []
    for values, shape in zip(frame.drop(columns=frame.geometry.name).to_dict("records"), frame.geometry, strict=True):
        given = values["line_id"]
        number = None if pd.isna(given) or int(given) not in lines else int(given)
        if number is not None and not _is_copy(lines[number], values):
            strange.append(number)
        line = None if shape is None else shapely.line_merge(shape) if shape.geom_type == "MultiLineString" else shape
        if line is None or line.geom_type != "LineString" or not (line.length and np.isfinite(line.bounds).all()):
            unread.append("new" if number is None else str(number))
            if number is not None:
                lines[number].is_there = True  # it was not deleted
            continue
        yield _Row(number, _kind(path, layer, values["kind"], lines.get(number or 0)), _vertices(line))
    if len(strange) > 0.1 * len(frame):
        raise DataError(
            f"{path} is not a copy of this inventory (line {strange[0]} of layer {layer!r} is another one): the survey "
            "was labelled again; edit the present inventory"
        )
    if unread:
        first = ", ".join(unread[:5]) + (", ..." if len(unread) > 5 else "")
        notes.append(f"{len(unread)} rows of layer {layer!r} are no single line (line_id {first})")


def _is_copy(line: _Line, values: Mapping[str, Any]) -> bool:
    """Return whether the fields x and y of a row, which an edit of its line leaves, are those of the inventory."""
    place = np.array([values["x"], values["y"]], np.float64)
    known = [own[0, :2] for own in (line.now, line.listed) if own is not None]
    return any(np.abs(own - place).max() <= MOVED for own in known)


def _kind(path: Path, layer: str, given: Any, line: _Line | None) -> str:
    """Return the kind of a row: its field, if that was edited or is new, else the kind of its layer."""
    text = "" if pd.isna(given) else str(given).strip()
    if text and text not in LINE_KINDS:
        raise DataError(f"{path}: layer {layer!r} has a row of the kind {text!r}: use {', '.join(LINE_KINDS)}")
    of_layer = LINE_LAYERS[layer]
    if line is None:
        return text or of_layer
    known = (line.kind, line.listed_kind)
    changed = next((kind for kind in (text, of_layer) if kind and kind not in known), None)
    return changed or line.kind


def _without_known(edits: _Edits, rows: Sequence[_Row]) -> list[_Row]:
    """Return the rows that are edits; lines that have a row are marked. Copies of a line that stays are new lines."""
    changed, whole = [], set[int | None]()
    for row in rows:
        own = None if row.number is None else edits.lines[row.number]
        if own is not None:
            own.is_there = True
            known = (own.listed, None if own.is_gone else own.now)
            if row.kind == own.kind and any(one is not None and _same(row.vertices, one) for one in known):
                whole.add(row.number)
                continue
            row.number = None if own.is_gone else row.number
        known_line = edits.line_of(row)
        if known_line is None:
            changed.append(row)
        elif row.number is None:
            known_line.is_there = True  # its row has lost its number
    return [row if row.number not in whole else replace(row, number=None) for row in changed]


def _missing(edits: _Edits, kinds: set[str]) -> dict[int, _Line]:
    """Return the labelled lines without a row, of layers that the file has; those of the page may be absent."""
    return {
        number: line
        for number, line in edits.lines.items()
        if line.listed is not None
        and line.listed_kind in kinds
        and not (line.is_there or line.is_rejected or line.is_gone)
    }


def _edit(path: Path, edits: _Edits, line: _Line, rows: list[_Row], missing: dict[int, _Line]) -> None:
    """Add the decisions of the edited rows of a line."""
    parts = _in_order(rows, line) if len(rows) > 1 else [rows[0]]
    if not parts:  # copies of the line, one of which may be the line itself
        rows = sorted(rows, key=lambda row: _apart(row.vertices, line.now))
        parts, copies = rows[:1], rows[1:]
        for row in copies:
            edits.found.append(Correction("add_line", kind=row.kind, payload={"parts": [_with_heights(edits, row)]}))
    first = parts[0]
    if first.kind != line.kind:
        edits.found.append(Correction("kind_line", kind=line.kind, payload={**line.named, "to": first.kind}))
        line.kind = first.kind
    whole = _with_heights(edits, first, line)
    if len(parts) > 1:
        _cut(edits, line, [_with_heights(edits, part, line) for part in parts])
        return
    if any(known is not None and _same(first.vertices, known) for known in (line.now, line.listed)):
        return
    gap = float(shapely.LineString(first.vertices[:, :2]).distance(shapely.LineString(line.now[:, :2])))
    if gap > FARTHEST:
        raise DataError(
            f"{path}: line {line.number} was moved by {gap:.0f} m, allowed are {FARTHEST:.0f} m: delete its row and "
            "draw one"
        )
    joined = [other for other in missing.values() if other.kind == line.kind and _lies_on(other.now, first.vertices)]
    for other in joined:
        payload = {**line.named, "other": {**other.named, "kind": other.kind}, "parts": [whole]}
        edits.found.append(Correction("join_lines", kind=line.kind, payload=payload))
        line.now = np.array(whole)
        del missing[other.number]
    if not joined:
        edits.found.append(Correction("shape_line", kind=line.kind, payload={**line.named, "parts": [whole]}))


def _cut(edits: _Edits, line: _Line, parts: list[list[list[float]]]) -> None:
    """Add the cuts that divide a line into parts, from its beginning."""
    number, begin = line.number, line.named
    for k in range(len(parts) - 1):
        rest = [vertex for j, part in enumerate(parts[k + 1 :]) for vertex in part[min(j, 1) :]]
        payload = {**begin, "line": number, "parts": [parts[k], rest]}
        edits.found.append(Correction("cut_line", kind=line.kind, payload=payload))
        number = edits.last + 1
        edits.lines[number] = _Line(number, line.kind, np.array(rest))
        begin = edits.lines[number].named


def _in_order(rows: Sequence[_Row], line: _Line) -> list[_Row]:
    """Return the rows of one number in the order of the line, each beginning where the one before ends; else none."""
    shape = shapely.LineString(line.now[:, :2])
    ordered = sorted(rows, key=lambda row: shape.line_locate_point(shapely.Point(row.vertices[:, :2].mean(axis=0))))
    pairs = pairwise(ordered)
    follow = all(np.abs(one.vertices[-1, :2] - two.vertices[0, :2]).max() <= MOVED for one, two in pairs)
    return ordered if follow and len({row.kind for row in rows}) == 1 else []


def _with_heights(edits: _Edits, row: _Row, line: _Line | None = None) -> list[list[float]]:
    """Return the vertices of a row; one without a height, or at 0 far from the ground, has that beside it."""
    vertices = row.vertices.copy()
    edits.drawn += vertices[:, :2].tolist()
    for vertex in vertices:
        height = _height_near(edits.ground, vertex[:2]) if line is None else _height_on(line.now, vertex[:2])
        if np.isnan(vertex[2]) or (vertex[2] == 0.0 and abs(height) > _ZERO):
            vertex[2] = height
            edits.n_without_height += 1
    return [[round(value, 3) for value in vertex] for vertex in vertices.tolist()]


def _height_near(places: NDArray[np.float64], place: NDArray[np.float64]) -> float:
    return float(places[np.argmin(np.hypot(*(places[:, :2] - place).T)), 2]) if len(places) else 0.0


def _height_on(line: NDArray[np.float64], place: NDArray[np.float64]) -> float:
    """Return the height of a line at its place nearest to another one."""
    shape = shapely.LineString(line[:, :2])
    ways = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])
    return float(np.interp(shape.line_locate_point(shapely.Point(place)), ways, line[:, 2]))


def _vertices(shape: Any) -> NDArray[np.float64]:
    found: NDArray[np.float64] = shapely.get_coordinates(shape, include_z=True)
    return found


def _same(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether lines have the same vertices; heights that are missing, or 0, are those of the other one."""
    if one.shape != other.shape:
        return False
    known = np.nan_to_num(one[:, 2]) != 0.0
    apart = np.abs(one - other)
    return bool(apart[:, :2].max() <= MOVED and apart[known, 2].max(initial=0.0) <= MOVED)


def _apart(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(shapely.hausdorff_distance(shapely.LineString(one[:, :2]), shapely.LineString(other[:, :2])))


def _lies_on(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether all vertices of a line lie on another one."""
    line = shapely.LineString(other[:, :2])
    return bool(shapely.distance(shapely.points(one[:, :2]), line).max() <= MOVED)
