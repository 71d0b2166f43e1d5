"""State and order of review of each object after all decisions in force."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypedDict

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.review import order_of_review
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, KINDS
from mlsroad_pipeline.review.corrections.decisions import LINE_ACTIONS, Anchor, Correction, Decision, named_objects
from mlsroad_pipeline.review.corrections.listed_objects import ListedObjects

STATUS = {
    "accept": "accepted",
    "reject": "rejected",
    "other_kind": "changed",
    "merge": "merged",
    "split": "split",
    "move_base": "moved",
}
"""Action to the value of the column `status`."""


FOLLOWED = ("accept", "other_kind", "move_base")
"""Actions that state that an object stands at a place: they hold whatever a later labelling lists there."""


class ObjectState(TypedDict, total=False):
    """Decisions about an object."""

    # A value of `STATUS`; an object that was moved and then accepted is accepted. The object that others were merged
    # into is `merged`; those others have `merged_into`.
    status: str
    # Class or kind that the user gave; that of the inventory for an accepted object; empty for a rejected one
    checked_class: str
    checked_kind: str  # Kind that the user gave, else that of the inventory
    # x, y, z: base that the user gave; missing if it was not moved
    x: float
    y: float
    z: float
    merged_into: int  # Number of the object that it belongs to
    merged: list[int]  # Numbers of the objects that were merged into it
    # bases, split_by: base points of its parts, x, y, z each, and the decision that gave them; missing if not split
    bases: list[list[float]]
    split_by: int
    decision: int  # Identifier of the last decision
    # who, made: user and time of the last decision
    who: str
    made: str


class Note(NamedTuple):
    """Texts about an object that a user has typed."""

    text: str
    attributes: dict[str, str]

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Note:
        """Return the note in the payload of a decision."""
        return cls(str(given.get("note", "")), dict(given.get("attributes", {})))


@dataclass(frozen=True)
class States:
    """Result of the decisions in force."""

    of_objects: dict[int, ObjectState] = field(default_factory=dict)  # State of objects of the present inventory
    # Decisions about objects that the present inventory does not have
    unmatched: list[Decision] = field(default_factory=list)
    painted: list[Decision] = field(default_factory=list)  # Painted points, in order
    # Objects that were missing: added ones, and accepted or changed ones that the present inventory does not have
    added: list[Decision] = field(default_factory=list)
    lines: list[Decision] = field(default_factory=list)  # Decisions about lines, in order
    checks: list[Decision] = field(default_factory=list)  # Decisions about states of compared entries, in order
    # Note and attributes of objects by number, and of added ones by the decision that added them
    notes: dict[int, Note] = field(default_factory=dict)
    notes_of_added: dict[int, Note] = field(default_factory=dict)


def fold_states(decisions: Sequence[Decision], objects: ListedObjects) -> States:
    """Return the state of each object of an inventory after the decisions in force."""
    states, lost = States(), dict[tuple[str, int], list[Decision]]()
    present = _present_numbers(decisions, objects)
    columns = (objects.table[name].astype(str).tolist() for name in ("kind", "class"))
    listed = dict(zip(objects.table["object_id"].tolist(), zip(*columns, strict=True), strict=True))
    for decision in decisions:
        action = decision.correction.action
        if action == "paint":
            states.painted.append(decision)
        elif action == "add":
            states.added.append(decision)
            states.notes_of_added[decision.identifier] = Note.of(decision.correction.payload)
        elif action == "note" and decision.correction.object_id is None:
            of = decision.correction.payload["added"]
            if of in states.notes_of_added:  # the object was not taken back
                states.notes_of_added[of] = Note.of(decision.correction.payload)
        elif action in LINE_ACTIONS:
            states.lines.append(decision)
        elif action == "check":
            states.checks.append(decision)
        else:
            numbers = [present.get((decision.identifier, number)) for number in named_objects(decision.correction)]
            if numbers[0] is None:
                lost.setdefault(_key(decision), []).append(decision)
            else:
                _apply_to_objects(states, decision, numbers[0], numbers[1:], listed)
    for number, state in states.of_objects.items():
        if "merged_into" in state:
            states.of_objects[state["merged_into"]].setdefault("merged", []).append(number)
    _keep_missing(states, lost.values())
    return states


def _keep_missing(states: States, lost: Iterable[Sequence[Decision]]) -> None:
    """Add the objects of decisions that the inventory does not list; decisions that say of none what it is stay."""
    for group in lost:
        notes = [decision for decision in group if decision.correction.action == "note"]
        missing = _missing([decision for decision in group if decision.correction.action != "note"])
        if missing is None:
            states.unmatched.extend(group)
            continue
        states.added.append(missing)
        states.notes_of_added[missing.identifier] = Note.of(notes[-1].correction.payload if notes else {})
    states.added.sort(key=lambda decision: decision.identifier)
    states.unmatched.sort(key=lambda decision: decision.identifier)


def _apply_to_objects(
    states: States,
    decision: Decision,
    own: int,
    others: Sequence[int | None],
    listed: Mapping[int, tuple[str, str]],
) -> None:
    """Apply a decision to its object and to the others that it names; `listed` has their kinds and classes."""
    if decision.correction.action == "note":
        states.notes[own] = Note.of(decision.correction.payload)
        return
    _apply(states.of_objects, decision, own, listed.get(own, ("", "")))
    for other in others:
        if other is not None and other != own:
            _apply(states.of_objects, decision, other, listed.get(other, ("", "")))
            states.of_objects[other]["merged_into"] = own


def _key(decision: Decision) -> tuple[str, int]:
    """Return what the decisions about one object of one inventory have in common."""
    number = named_objects(decision.correction)[0]
    anchor = decision.anchors.get(number)
    return ("" if anchor is None else anchor.inventory, number)


def _missing(decisions: Sequence[Decision]) -> Decision | None:
    """Return the decisions about an object that is not listed any more as an added object; None unless it is one."""
    moved = [decision for decision in decisions if decision.correction.action == "move_base"]
    others = [decision for decision in decisions if decision.correction.action != "move_base"]
    if not decisions:
        return None
    last = (others or moved)[-1]
    given, anchor = last.correction, last.anchors.get(named_objects(last.correction)[0])
    if anchor is None or given.action not in FOLLOWED:
        return None
    name = given.payload.get("class") or (anchor.name if given.action != "other_kind" else None)
    of_class = name if name in KINDS else KIND_OF_CLASS.get(str(name))
    kind = given.kind or (of_class if given.action == "other_kind" else anchor.kind)
    if kind not in KINDS:
        return None
    place = {axis: float((moved[-1].correction.payload if moved else vars(anchor))[axis]) for axis in "xyz"}
    added = Correction("add", kind=kind, payload=place | ({} if name is None else {"class": name}))
    return replace(last, correction=added, anchors={})


def _apply(states: dict[int, ObjectState], decision: Decision, number: int, listed: tuple[str, str]) -> None:
    given, action = decision.correction, decision.correction.action
    state = states.setdefault(number, {"status": "", "checked_class": listed[1], "checked_kind": listed[0]})
    anchor = decision.anchors.get(named_objects(given)[0])
    is_other = action in FOLLOWED and not state["status"] and anchor is not None and listed[0] != anchor.kind
    state["decision"], state["who"], state["made"] = decision.identifier, decision.who, decision.made
    if action == "move_base":
        state["x"], state["y"], state["z"] = (float(given.payload[axis]) for axis in "xyz")
    if is_other and anchor is not None and action != "other_kind":  # accepted as another kind than that of now
        state["status"], state["checked_kind"] = STATUS["other_kind"], anchor.kind
        state["checked_class"] = str(given.payload.get("class") or anchor.name)
        return
    if action == "move_base":
        state["status"] = state["status"] or STATUS[action]
        return
    state["status"] = STATUS[action]
    state.pop("merged_into", None)
    if action == "split":
        state["bases"] = [[float(value) for value in base] for base in given.payload["bases"]]
        state["split_by"] = decision.identifier
    if action == "reject":
        state["checked_class"] = str(given.payload.get("class", ""))
    elif action == "other_kind":
        state["checked_class"], state["checked_kind"] = given.checked_class, given.kind or listed[0]
    else:
        state["checked_class"] = str(given.payload.get("class") or state["checked_class"] or listed[1])


def _present_numbers(decisions: Sequence[Decision], objects: ListedObjects) -> dict[tuple[int, int], int | None]:
    """Return the present number of each object that a decision names, by identifier and number then.

    Decisions about the same object of the same inventory are searched together.
    """
    groups: dict[tuple[str, int], int] = {}
    anchors: dict[int, list[tuple[int, Anchor, str]]] = {}
    members: list[tuple[tuple[int, int], int]] = []
    last_actions: dict[int, str] = {}
    for decision in decisions:
        given = decision.correction.kind or ""
        for number in named_objects(decision.correction):
            anchor = decision.anchors.get(number)
            if anchor is None:
                continue
            key = groups.setdefault((anchor.inventory, number), len(groups))
            before = anchors.setdefault(key, [])
            before.append((number, anchor, given or (before[-1][2] if before else "")))
            members.append(((decision.identifier, number), key))
            last_actions[key] = decision.correction.action
    kept = {key for key, action in last_actions.items() if action in FOLLOWED}
    found = objects.find(anchors, of_any_kind=kept)
    return {member: found[key] for member, key in members}


_NEEDED = ("object_id", "kind", "score", "point_count")


def review_order(
    inventory_rows: Sequence[Mapping[str, Any]] | pd.DataFrame, states: Mapping[int, ObjectState], number: int
) -> list[dict[str, Any]]:
    """Return the objects to look at first."""
    table = inventory_rows if isinstance(inventory_rows, pd.DataFrame) else pd.DataFrame(list(inventory_rows))
    if table.empty:
        return []
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        raise DataError(f"order of review: the inventory has no column {missing[0]!r}")
    table = table.reset_index(drop=True)
    known = {"accepted": 1.0, "moved": 1.0, "split": 1.0, "merged": 1.0, "changed": 1.0, "rejected": 0.0, "": np.nan}
    decided = np.array([known[states.get(int(n), {}).get("status", "")] for n in table["object_id"]], dtype=np.float64)
    order = order_of_review(table, decided, number)
    columns = ("object_id", "kind", "score")
    picked = table.loc[order.rows, list(columns)].to_dict("records")
    return [
        {**{str(name): value for name, value in row.items()}, "reason": reason, "expected_precision": float(precision)}
        for row, reason, precision in zip(picked, order.reasons, order.precision, strict=True)
    ]
