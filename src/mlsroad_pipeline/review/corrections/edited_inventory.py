"""Corrections from a GeoPackage that was edited in another program, such as QGIS."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
from pyproj import CRS

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.formats.las.header import class_names, read_header
from mlsroad_pipeline.inventory_files.crs_checks import known_system
from mlsroad_pipeline.inventory_files.road_inventory import ATTRIBUTE, LAYERS, is_note
from mlsroad_pipeline.review.corrections.answers import NamedClasses
from mlsroad_pipeline.review.corrections.decisions import FARTHEST, Correction, check_values
from mlsroad_pipeline.review.corrections.edited_layers import far_away, read_layers, rows_of
from mlsroad_pipeline.review.corrections.inventory_columns import note_cells
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.review.corrections.listed_objects import ListedObjects
from mlsroad_pipeline.review.corrections.states import STATUS, Note, ObjectState

MOVED = 0.01
"""Least distance in plan or height at which a base point counts as moved, metres."""

_ACTIONS = {status: action for action, status in STATUS.items()}
_TYPED = ("accepted", "rejected", "changed")
_ZERO = 1.0  # height of the ground from which a height of 0 is none, metres


def corrections_of_inventory(
    path: Path,
    objects: ListedObjects,
    states: dict[int, ObjectState],
    *,
    classes: Collection[str],
    system: CRS | None,
    many_deleted: bool = False,
    notes_before: Mapping[int, Note] | None = None,
    left_out: Collection[int] = (),
) -> tuple[list[Correction], list[str]]:
    """Return the corrections that an edited GeoPackage holds and the store does not, and what was not compared.

    Compared are the layer `objects` and those of the kinds: `status`, `checked_class`, `class` and `kind`, base points,
    deleted rows (rejected) and new rows (added), `note` and the columns of attributes (`attr_...`). Objects `left_out`
    of a delivered inventory, which have the class of no object, are not deleted.
    """
    notes_before = notes_before or {}
    notes: list[str] = []
    layers = read_layers(path, system, notes)
    listed = objects.table.set_index("object_id")
    found: dict[tuple[int, str], Correction] = {}
    added: list[Correction] = []
    for layer, frame in layers.items():
        _check_copy(path, frame, listed)
        for row in _with_heights(_without_copies(rows_of(frame, layer, notes), listed), listed, notes):
            number = row["object_id"]
            if number is None or number not in listed.index:
                is_delivered = (row["status"], row["centre"]) == ("added", None) or (
                    number and row["status"] == "split"
                )
                added += [] if is_delivered else [_added(path, row, layer)]
                continue
            changes = _changes(path, row, number, listed.loc[number], states.get(number, {}))
            for correction in (*changes, *_noted(path, row, number, listed.loc[number], notes_before.get(number))):
                own = correction.action if correction.action in ("move_base", "note") else ""
                other = found.setdefault((number, own), correction)
                if other != correction:
                    raise DataError(
                        f"{path}: object {number} is edited in two ways ({_described(other)}; "
                        f"{_described(correction)}): edit it in one layer"
                    )
    _check_values(path, [*found.values(), *added], {*classes, *listed["class"].astype(str)})
    deleted = [number for number in _deleted(layers, listed, states) if number not in left_out]
    if len(deleted) > max(len(listed) / 2, 1) and not many_deleted:
        raise DataError(
            f"{path} lacks {len(deleted)} of {len(listed)} objects, which would be rejected: is it whole? "
            "--many-deleted accepts it"
        )
    decided = [number for number, _ in found]
    rejected = [Correction("reject", number) for number in deleted if number not in decided]
    places = [[row.payload["x"], row.payload["y"]] for row in added]
    notes += far_away("added objects", places, listed[["x", "y"]].dropna().to_numpy(np.float64))
    return [*found.values(), *rejected, *_distinct(added)], list(dict.fromkeys(notes))


def _check_copy(path: Path, frame: gpd.GeoDataFrame, listed: pd.DataFrame) -> None:
    """Check that rows of equal numbers have the places of the inventory in their fields x and y."""
    known = frame[frame["object_id"].isin(listed.index)]
    if known.empty:
        return
    there = listed.loc[known["object_id"].astype("int64"), ["x", "y"]].to_numpy(dtype=np.float64)
    apart = np.abs(known[["x", "y"]].to_numpy(dtype=np.float64) - there).max(axis=1)
    if (apart > MOVED).mean() > 0.1:
        number = int(known["object_id"].to_numpy()[int(np.argmax(apart))])
        raise DataError(
            f"{path} is not a copy of this inventory (object {number} is another one): the survey was labelled again; "
            "edit the present inventory"
        )


def _with_heights(rows: list[dict[str, Any]], listed: pd.DataFrame, notes: list[str]) -> list[dict[str, Any]]:
    """Return rows in which points without a height, or at 0 far from the ground, have that of the nearest object."""
    known = listed[["x", "y", "z"]].dropna().to_numpy(dtype=np.float64)
    n = 0
    for row in rows if len(known) else ():
        name = "place" if row["object_id"] in listed.index else "centre"
        if row[name] is None or row[name][2]:
            continue
        x, y, z = row[name]
        base = float(known[np.argmin(np.hypot(*(known[:, :2] - (x, y)).T)), 2])
        if z is None or abs(base) > _ZERO:
            row[name], n = (x, y, base), n + 1
    if n:
        notes.append(f"{n} rows have no height, or 0: the height of the nearest object of the inventory is taken")
    return rows


def _without_copies(rows: list[dict[str, Any]], listed: pd.DataFrame) -> list[dict[str, Any]]:
    """Return rows in which a number occurs once, nearest to the object; copied rows are new objects."""
    counts = Counter(row["object_id"] for row in rows if row["object_id"] in listed.index)
    for number in [number for number, count in counts.items() if count > 1]:
        own = [row for row in rows if row["object_id"] == number]
        base = [listed.loc[number, axis] for axis in "xy"]
        nearest = min(own, key=lambda row: np.inf if row["centre"] is None else _apart(row["centre"][:2], base))
        for row in own:
            if row is not nearest:
                row["object_id"] = None
    return rows


def _changes(path: Path, row: dict[str, Any], number: int, listed: pd.Series, state: ObjectState) -> list[Correction]:
    """Return the corrections of one row: the decision about the object, and its base."""
    changes = []
    status, given = row["status"].lower(), row["checked_class"]
    before, known = state.get("status", ""), state.get("checked_class", "")
    if status and status not in (*_ACTIONS, "added"):
        raise DataError(f"{path}: unknown status {row['status']!r} of object {number}: use {', '.join(_TYPED)}")
    stored = {name: listed.get(name) for name in ("status", "checked_class")}
    written = {name: "" if pd.isna(value) else str(value) for name, value in stored.items()}
    named = next((n for n in (row["class"], row["kind"]) if n and n not in (listed["class"], listed["kind"])), "")
    if given and given not in (written["checked_class"], str(listed["class"]), str(listed["kind"])):
        named = given
    if named:
        given_class = {"kind": named} if named in KINDS else {"payload": {"class": named}}
        changes += [] if named == known else [Correction("other_kind", number, **given_class)]
    elif status in (written["status"], before):
        pass
    elif status in ("accepted", "rejected"):
        changes.append(Correction("accept" if status == "accepted" else "reject", number))
    elif status == "changed":
        raise DataError(f"{path}: object {number} has the status changed without another checked_class: name its class")
    if row["place"] is not None:
        x, y, z = row["place"]
        place = [x, y, float(listed["z"]) if z is None else z]
        is_edited = _apart(place, [listed[axis] for axis in "xyz"]) > MOVED
        known_places = [[state.get(axis, listed[axis]) for axis in "xyz"], *state.get("bases", ())]
        if is_edited and min(_apart(place, known) for known in known_places) > MOVED:
            apart = _apart(place[:2], [listed[axis] for axis in "xy"])
            if apart > FARTHEST:
                raise DataError(
                    f"{path}: object {number} was moved by {apart:.0f} m, allowed are {FARTHEST:.0f} m: "
                    "delete its row and add one"
                )
            changes.append(Correction("move_base", number, payload=dict(zip("xyz", place, strict=True))))
    return changes


def _noted(path: Path, row: dict[str, Any], number: int, listed: pd.Series, before: Note | None) -> list[Correction]:
    """Return the note and the attributes of a row if it changes them; empty cells change nothing."""
    known = note_cells(before)
    cells = {name.lower(): _text(value) for name, value in row.items() if is_note(name.lower())}
    edited = {n: text for n, text in cells.items() if text not in ("", known.get(n, ""), _text(listed.get(n)))}
    if not edited:
        return []
    now = known | edited
    attributes = {name.removeprefix(ATTRIBUTE): text for name, text in now.items() if name != "note"}
    try:
        return [Correction("note", number, payload={"note": now.get("note", ""), "attributes": attributes})]
    except ParameterError as error:
        raise DataError(f"{path}: object {number}: {error}") from error


def _text(value: Any) -> str:
    """Return a cell as text; whole numbers of a numeric column without decimals."""
    if value is None or pd.isna(value):
        return ""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value).strip()


def _apart(place: Sequence[Any], other: Sequence[Any]) -> float:
    return float(np.abs(np.asarray(place, np.float64) - np.asarray(other, np.float64)).max())


def _added(path: Path, row: dict[str, Any], layer: str) -> Correction:
    kind = row["kind"] or LAYERS.get(layer, "")
    if kind not in KINDS:
        raise DataError(f"{path}: an added row of layer {layer!r} has the kind {kind!r}: use {', '.join(KINDS)}")
    if row["centre"] is None:
        raise DataError(f"{path}: an added row of layer {layer!r} has no geometry: draw its point or delete it")
    x, y, z = row["centre"]
    given = {"class": row["class"]} if row["class"] else {}
    given |= next((dict(note.payload) for note in _noted(path, row, 1, pd.Series(dtype=object), None)), {})
    return Correction("add", kind=kind, payload={"x": x, "y": y, "z": 0.0 if z is None else z, **given})


def _check_values(path: Path, corrections: Sequence[Correction], known: set[str]) -> None:
    """Raise DataError for a correction with a value that no decision may have."""
    for correction in corrections:
        try:
            check_values(correction, classes=known)
        except ParameterError as error:
            where = "an added row" if correction.object_id is None else f"object {correction.object_id}"
            raise DataError(f"{path}: {where}: {error}") from error


def _distinct(added: list[Correction]) -> list[Correction]:
    kept: dict[tuple[float, float, str | None], Correction] = {}
    for correction in added:
        kept.setdefault((correction.payload["x"], correction.payload["y"], correction.kind), correction)
    return list(kept.values())


def _deleted(layers: dict[str, gpd.GeoDataFrame], listed: pd.DataFrame, states: dict[int, ObjectState]) -> list[int]:
    """Return the objects that a layer lacks and that are not yet rejected or merged into another one."""
    gone = []
    present = {name: set(frame["object_id"].dropna().astype("int64")) for name, frame in layers.items()}
    drawn = set().union(*(present[name] for name in LAYERS if name in present))  # an object of a changed kind moves
    of_kind = {kind: layer for layer, kind in LAYERS.items()}
    for number, kind in zip(listed.index.tolist(), listed["kind"].astype(str), strict=True):
        state: ObjectState = states.get(number, {})
        if state.get("status") == "rejected" or "merged_into" in state:
            continue
        is_listed = "objects" not in present or number in present["objects"]
        is_drawn = of_kind.get(kind, "") not in present or number in drawn
        if not (is_listed and is_drawn):
            gone.append(number)
    return gone


def _described(correction: Correction) -> str:
    return f"{correction.action} {correction.checked_class}".strip()


def known_names(folder: Path) -> frozenset[str]:
    """Return the kinds, and the names of classes that the model of an output can learn; kinds alone without a run."""
    try:
        output = LabelledOutput.at(folder)
        cloud = next(iter(output.clouds().values()))
    except ReadError:
        return frozenset(KINDS)
    scheme = output.model_scheme(class_names(read_header(cloud)))
    if scheme is None:
        classes = {name for spec in output.schemes.values() for name in spec["classes"]}
        return frozenset({*KINDS, *classes, *output.record["summary"].get("classes", ())})
    return frozenset({*KINDS, *NamedClasses(scheme, output.schemes).names})


def system_of(folder: Path) -> CRS | None:
    """Return the coordinate reference system of the inventory of an output, None if it has none."""
    path = folder / "inventory.gpkg"
    if not path.is_file():
        return None
    try:
        return known_system(pyogrio.read_info(path, layer="objects")["crs"])
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        raise ReadError(f"{path}: not a GeoPackage inventory: {error}") from error
