"""Objects of an inventory after the decisions: kinds, parts of split objects, merged and added objects."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_table, lines_near
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.objects.boxes import oriented_box
from mlsroad_pipeline.algorithms.inventory.objects.measures import EXTENT, MEASURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, KINDS
from mlsroad_pipeline.algorithms.inventory.objects.sections import equal_sections, line_lengths, section_table
from mlsroad_pipeline.algorithms.inventory.objects.table import FIELDS_OF_KINDS, OBJECT_FIELDS, new_keys
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory, footprint_text, line_vertices, note_columns
from mlsroad_pipeline.review.corrections.inventory_columns import note_cells, with_states
from mlsroad_pipeline.review.corrections.line_decisions import line_states
from mlsroad_pipeline.review.corrections.states import ObjectState, States

KindsOf = Mapping[str, Collection[str]]
"""Class name to the kinds of objects that its members have; none for classes of no object."""


def kinds_of_classes(schemes: Mapping[str, Any]) -> dict[str, set[str]]:
    """Return the kinds of the classes of configured schemes, by name, and of the kinds themselves."""
    found: dict[str, set[str]] = {}
    for spec in schemes.values():
        for name, entry in spec.get("classes", {}).items():
            members = [member for member in entry.get("members", ()) if member in KIND_OF_CLASS]
            found.setdefault(name, set()).update(KIND_OF_CLASS[member] for member in members)
    return found | {kind: {kind} for kind in KINDS}


def kind_of(state: ObjectState, listed: str, kinds: KindsOf) -> str:
    """Return the kind of an object after its decisions; empty where its class is that of no object."""
    if state["status"] != "changed" or state["checked_kind"] != listed:
        return state["checked_kind"]
    own = kinds.get(state["checked_class"])
    if own is None or listed in own:
        return listed
    return next(iter(own)) if len(own) == 1 else "" if not own else listed


def corrected_inventory(
    inventory: RoadInventory,
    states: States,
    *,
    kinds: KindsOf | None = None,
    keep_rejected: bool = False,
    checked: bool = False,
) -> RoadInventory:
    """Return an inventory after all decisions in force.

    Objects have the base points, classes and kinds that users gave; split and added ones are rows of their own. Left
    out are rejected objects, those that were merged into others and those that are of no kind, unless `keep_rejected`
    is set, and with `checked` all that nobody has looked at.
    """
    table = with_states(inventory.objects, states)
    rows = {int(row["object_id"]): row for row in _records(table)}
    gone = [n for n in rows if _is_gone(states.of_objects.get(n), rows[n]["kind"], kinds or {})]
    for number, state in states.of_objects.items():
        if number in rows:
            _apply(rows, number, state, kinds or {})
    new = new_rows(inventory.objects, states, kinds=kinds)
    for row in new:
        if row["object_id"] in rows:  # the first part of a split object
            rows[row["object_id"]] = row
    kept = [row for n, row in rows.items() if keep_rejected or n not in gone]
    kept += [row for row in new if row["object_id"] not in rows]
    objects = _typed([row for row in kept if row["status"] or not checked], note_columns(table))
    lost = ~objects["pole_id"].isin(objects.loc[objects["kind"] == "pole", "object_id"])
    objects["pole_id"] = objects["pole_id"].mask(lost, 0)
    objects["key"] = new_keys(objects, crs=inventory.crs)
    lines = _kept_lines(inventory, states, keep_rejected, checked)
    return _measured_along(replace(inventory, objects=objects, lines=lines))


def _kept_lines(inventory: RoadInventory, states: States, keep_rejected: bool, checked: bool) -> pd.DataFrame | None:
    if inventory.lines is None and not states.lines:
        return None
    listed = line_table([]) if inventory.lines is None else inventory.lines
    found = line_states(states.lines, listed, inventory.trajectory)
    lines = found.apply(listed)
    status = [found.status.get(number, "") for number in lines["line_id"].tolist()]
    kept = [(s != "rejected" or keep_rejected) and (s != "" or not checked) for s in status]
    return lines[np.array(kept, dtype=np.bool_)].reset_index(drop=True)


def within_reach(inventory: RoadInventory, reach: float) -> RoadInventory:
    """Return the objects and lines at most `reach` metres from the path; DataError without a path."""
    if inventory.trajectory is None:
        raise DataError("the survey has no path: distances from it are unknown (--within)")
    objects, lines, path = inventory.objects, inventory.lines, inventory.trajectory
    if len(objects):
        objects = objects[path.distance(objects[["x", "y", "z"]].to_numpy(np.float64)) <= reach].reset_index(drop=True)
    lines = None if lines is None else lines_near(lines, path, reach).reset_index(drop=True)
    return _measured_along(replace(inventory, objects=objects, lines=lines))


def changed_rows(
    objects: pd.DataFrame, states: States, *, kinds: KindsOf | None = None, last: int
) -> list[dict[str, Any]]:
    """Return the objects that decisions have changed, and those of `new_rows`; `objects` may be the changed ones alone.

    `last` is the largest number of the inventory. Objects that are not delivered keep their rows.
    """
    rows = {int(row["object_id"]): row for row in _records(with_states(objects, states))}
    for number, state in states.of_objects.items():
        if number in rows:
            _apply(rows, number, state, kinds or {})
    new = {row["object_id"]: row for row in new_rows(objects, states, kinds=kinds, last=last)}
    return [*({**rows, **new}).values()]


def new_rows(
    objects: pd.DataFrame, states: States, *, kinds: KindsOf | None = None, last: int = 0
) -> list[dict[str, Any]]:
    """Return the objects that decisions have made: all parts of split objects, and added ones.

    The first part keeps the number of its object. Further parts and added objects are numbered after all others in the
    order of the decisions. A part has the share of the outline that is nearest to its base. Beside the columns of the
    inventory, rows have `decision`, that which made them, and `of`, the number of the split object (0 if added).
    """
    listed: dict[int, dict[str, Any]] = {}
    if any("bases" in state for state in states.of_objects.values()):  # rows of a table are slow to take
        decided = objects[objects["object_id"].isin(list(states.of_objects))]
        listed = {int(row["object_id"]): row for row in _records(with_states(decided, states))}
    made: list[tuple[int, list[dict[str, Any]]]] = [
        (n, [_added_row(decision.correction) | note_cells(states.notes_of_added[n]) | {"of": 0}])
        for decision in states.added
        for n in (decision.identifier,)
    ]
    for number, state in states.of_objects.items():
        if "bases" in state and number in listed and "merged_into" not in state:
            _apply(listed, number, {**state, "x": np.nan}, kinds or {})
            made.append((state["split_by"], [part | {"of": number} for part in _parts(listed[number], state)]))
    last = max(last, int(objects["object_id"].max()) if len(objects) else 0)
    rows = []
    for decision, group in sorted(made, key=lambda item: item[0]):
        for row in group:
            if not row["object_id"]:
                last += 1
                row["object_id"] = last
            rows.append(row | {"decision": decision})
    return rows


def _is_gone(state: ObjectState | None, listed: str, kinds: KindsOf) -> bool:
    return state is not None and (
        state["status"] == "rejected" or "merged_into" in state or not kind_of(state, listed, kinds)
    )


def _apply(rows: dict[int, dict[str, Any]], number: int, state: ObjectState, kinds: KindsOf) -> None:
    """Change the row of an object as its decisions say; measures of another kind are unknown."""
    row = rows[number] = dict(rows[number])
    merged = [rows[n] for n in state.get("merged", ()) if n in rows]
    if merged:
        row |= _outlined(row, shapely.unary_union([_outline(r) for r in (row, *merged)]).convex_hull)
        row |= {f"z_{end}": pick(r[f"z_{end}"] for r in (row, *merged)) for end, pick in (("min", min), ("max", max))}
        row["height"] = row["z_max"] - row["z"]
        row["point_count"] += sum(r["point_count"] for r in merged)
    if np.isfinite(state.get("x", np.nan)):
        row |= {"x": state["x"], "y": state["y"], "z": state["z"], "station": np.nan}
    if state["status"] != "rejected":
        kind = kind_of(state, row["kind"], kinds)
        row |= {"class": state["checked_class"], "kind": kind or row["kind"]}
        row |= {name: _BLANK[name] for name, own in FIELDS_OF_KINDS.items() if row["kind"] not in own}


def _parts(row: Mapping[str, Any], state: ObjectState) -> Iterator[dict[str, Any]]:
    """Yield the parts of a split object, the first with its number; a rejected first part is left out."""
    bases = np.array(state["bases"], dtype=np.float64)
    unknown = {
        name: _BLANK[name]
        for name in (
            *MEASURES,
            *("point_count", "disagreeing_share", "pole_id", "facing_from", "station", "complete"),
            *("pole_type", "panel_shape"),
        )
    }
    for k, base in enumerate(bases):
        if k == 0 and state["status"] == "rejected":
            continue
        share = _outline(row).intersection(_nearest(bases, k))
        part = {**row, **unknown, **dict(zip("xyz", base.tolist(), strict=True)), "kind": row["kind"]}
        part |= {"key": ""} if k else {}
        part |= {"object_id": 0 if k else row["object_id"], "status": "split" if k else row["status"]}
        part |= {"reasons": f"part {k + 1} of {len(bases)} of object {row['object_id']}"}
        yield part | _outlined(part, share) | {"height": row["z_max"] - base[2]}


def _nearest(bases: np.ndarray, number: int, reach: float = 1000.0) -> Any:
    """Return the area that is nearer to a base than to the others, in plan."""
    own = bases[number, :2]
    area = shapely.box(*(own - reach), *(own + reach))
    for other in np.delete(bases[:, :2], number, axis=0):
        way = (other - own) / max(float(np.hypot(*(other - own))), 1e-9)
        across, middle = np.array([-way[1], way[0]]), (own + other) / 2
        corners = [middle + across * reach * 2, middle - across * reach * 2]
        area = area.intersection(shapely.Polygon([*corners, *(corner - way * reach * 4 for corner in corners[::-1])]))
    return area


def _outline(row: Mapping[str, Any]) -> Any:
    """Return the outline of an object: its footprint, else the box of its points, else its base."""
    if row["footprint"]:
        return shapely.from_wkt(row["footprint"])
    limits = [row[name] for name in ("x_min", "y_min", "x_max", "y_max")]
    return shapely.box(*limits) if np.isfinite(limits).all() else shapely.Point(row["x"], row["y"])


def _outlined(row: Mapping[str, Any], outline: Any) -> dict[str, Any]:
    """Return the measures that follow from an outline."""
    if outline.geom_type != "Polygon" or outline.is_empty:
        limits = [row["x"], row["y"], row["x"], row["y"]]
        return {"footprint": "", **dict(zip(("x_min", "y_min", "x_max", "y_max"), limits, strict=True))}
    found: dict[str, Any] = {"footprint": str(footprint_text(np.array([shapely.orient_polygons(outline)]))[0])}
    found |= dict(zip(("x_min", "y_min", "x_max", "y_max"), outline.bounds, strict=True))
    centre, longer, shorter, heading = oriented_box(shapely.get_coordinates(outline)[:-1])
    if row["kind"] == "vehicle":
        found |= {"x": centre[0], "y": centre[1], "length": longer, "width": shorter, "heading": heading}
    else:
        found["width"] = longer
    return found | ({"crown_diameter": 2 * np.sqrt(outline.area / np.pi)} if row["kind"] == "tree" else {})


def _added_row(correction: Any) -> dict[str, Any]:
    """Return an object that a user added; its measures are unknown."""
    place = {axis: float(correction.payload[axis]) for axis in "xyz"}
    extent = {f"{axis}_{end}": value for axis, value in place.items() for end in ("min", "max")}
    given = {"class": correction.checked_class, "kind": correction.kind, "checked_class": correction.checked_class}
    return {**_BLANK, **given, "status": "added", **place, **extent}


_BLANK: dict[str, Any] = {
    n: np.nan if kind == "float64" else 0 if kind == "int64" else "" for n, kind in OBJECT_FIELDS.items()
}
_MILLIMETRES = (*MEASURES, *EXTENT, "station", "offset")


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]


def _typed(rows: Sequence[Mapping[str, Any]], notes: Sequence[str]) -> pd.DataFrame:
    blank = dict.fromkeys(notes, "")
    table = pd.DataFrame([blank | dict(row) for row in rows], columns=[*OBJECT_FIELDS, *notes])
    table = table.astype({**OBJECT_FIELDS, **dict.fromkeys(notes, "str")})
    return table.round(dict.fromkeys(_MILLIMETRES, 3))


def _measured_along(inventory: RoadInventory) -> RoadInventory:
    """Return an inventory with the stations of its objects, and their numbers per section of the road."""
    path, objects = inventory.trajectory, inventory.objects.copy()
    if path is None:
        return inventory
    moved = objects["station"].isna()
    if moved.any():
        along = path.locate(objects.loc[moved, ["x", "y", "z"]].to_numpy())
        objects.loc[moved, ["station", "offset"]] = np.column_stack(along).round(3)
    return replace(inventory, objects=objects, sections=_sections(inventory, objects, path))


def _sections(inventory: RoadInventory, objects: pd.DataFrame, path: Trajectory) -> pd.DataFrame | None:
    """Return the sections with the present numbers of objects and lengths of lines."""
    before = inventory.sections
    if before is None:
        return None
    ends, usual = ["from_station", "to_station"], equal_sections(path.length)
    is_usual = len(usual) == len(before) and np.allclose(usual[ends], before[ends], atol=0.01)
    counted = section_table(objects, path.length, sections=None if is_usual else before)
    if (lines := inventory.lines) is not None:
        for kind in LINE_KINDS:
            counted[f"{kind}_length"] = line_lengths(line_vertices(lines[lines["kind"] == kind]), path, counted)
    return counted
