"""Entries of a compared register, objects of two compared surveys and places of a road, whose states users check.

Imports no pandas.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
import sqlite3
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.execution.run_identity import finished_record

if TYPE_CHECKING:
    from mlsroad_pipeline.review.corrections.decisions import Correction, Decision

CHECKED = ("right", "wrong")
"""Decisions of a user about a state."""
KINDS = ("pole", "sign", "tree")
_SAME_PLACE = 1.0  # largest move of an entry whose decision stays in force, such as by another offset, metres


class Compared(NamedTuple):
    """A table of `mlsroad compare` or `mlsroad road`."""

    file: str
    name: str  # Column with the names of entries
    object: str  # Column with the objects of this survey; 0 for none
    asked: tuple[str, ...]  # States to check, the most important first
    others: tuple[str, ...]
    further: tuple[str, ...]  # Columns for the reason
    kinds: tuple[str, ...] = KINDS
    again: str = "compare again"  # What writes the table anew

    @property
    def states(self) -> tuple[str, ...]:
        """All states."""
        return self.asked + self.others


COMPARED = {
    "register": Compared(
        "register/register.csv", "id", "object_id", ("not found", "different kind", "moved", "new"),
        ("not visible", "confirmed"), ("evidence", "object_kind", "distance", "rays"),
    ),
    "changes": Compared(
        "changes/changes.csv", "key", "second_id", ("gone", "different kind", "moved", "new", "changed"),
        ("not visible in the first", "not visible in the second", "unchanged"), ("z", "changes", "reason"),
    ),
    "road": Compared(
        "road/road_places.csv", "place", "object_id", ("intruded", "low"), ("measured",), ("z", "reason"), ("station",),
        "measure the road again",
    ),
}  # fmt: skip
"""Tables below a folder of results, by name."""


class Entry(NamedTuple):
    """An entry of a compared table."""

    name: str  # Unique in its table
    kind: str
    state: str
    x: float
    y: float
    z: float | None
    object_id: int  # In this survey; 0 for none
    reason: str
    asks: bool  # Whether its state is to be checked


def compared_entries(
    folder: Path, names: Collection[str] = tuple(COMPARED)
) -> tuple[dict[str, list[Entry]], list[str]]:
    """Return the entries of each compared table of a folder of results, and a line for each that is left out."""
    found, left_out, root = dict[str, list[Entry]](), [], folder.resolve()
    for name in names:
        path = folder / COMPARED[name].file
        if not path.is_file():
            continue
        try:
            if not path.resolve().is_relative_to(root):
                raise ReadError(f"{path} is a link out of the folder: left out")
            if name == "road":
                _check_inventory(folder, path)
            found[name] = entries_of(path.read_bytes(), name, path)
        except (ReadError, OSError) as error:
            left_out.append(str(error))
    return found, left_out


def inventory_digest(record: Mapping[str, Any]) -> str:
    """Return the digest of the inventory that a run of `label` wrote; empty if it names none."""
    digests = (str(entry["blake2b"]) for entry in record["outputs"] if entry["path"] == "inventory.gpkg")
    return next(digests, "")


def _check_inventory(folder: Path, path: Path) -> None:
    """Raise ReadError for places of a road whose objects are those of an earlier inventory."""
    layers, record = path.with_name("road.gpkg"), finished_record(folder)
    try:
        with closing(sqlite3.connect(f"{layers.resolve().as_uri()}?mode=ro", uri=True)) as base:
            facts = dict(json.loads(base.execute("SELECT metadata FROM gpkg_metadata").fetchone()[0]))
    except (sqlite3.Error, TypeError, ValueError) as error:
        raise ReadError(f"{layers} is damaged ({error}): measure the road again with --overwrite") from error
    if record is not None and facts.get("inventory") != inventory_digest(record):
        raise ReadError(f"{path} is older than the labels of the survey: measure the road again with --overwrite")


def entries_of(content: bytes, name: str, path: Path) -> list[Entry]:
    """Return the entries of a compared table in its order; ReadError if it is damaged or another table."""
    compared, entries, seen = COMPARED[name], list[Entry](), dict[str, int]()
    needed = {compared.name, compared.object, "kind", "state", "x", "y", *compared.further}
    try:
        text = content.decode("utf-8")
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ReadError(f"{path} is damaged ({error}): {compared.again} with --overwrite") from error
    if not rows or not needed <= set(rows[0]):
        missing = min(needed - set(rows[0] if rows else ()))
        raise ReadError(f"{path} has no column {missing!r}: it is no such table; rename it, or {compared.again}")
    if not text.endswith("\n"):
        raise ReadError(f"{path} is damaged (its last line is cut): {compared.again} with --overwrite")
    for number, values in enumerate(rows[1:], 2):
        try:
            entry = _entry(dict(zip(rows[0], values, strict=True)), compared)
        except ValueError as error:
            raise ReadError(f"{path} is damaged (line {number}: {error}): {compared.again} with --overwrite") from error
        seen[entry.name] = count = seen.get(entry.name, 0) + 1
        entries.append(entry if count == 1 else entry._replace(name=f"{entry.name} ({count})"))
    return entries


def _entry(row: dict[str, str], compared: Compared) -> Entry:
    kind, state = row["kind"], row["state"]
    if kind not in compared.kinds or state not in compared.states:
        raise ValueError(f"unknown kind {kind!r} or state {state!r}")
    x, y, z = (float(row.get(axis) or "nan") for axis in "xyz")
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"no place {row['x']!r}, {row['y']!r}")
    number = int(float(row[compared.object] or 0))
    name = re.sub(r"(?<=\d)\.0$", "", row[compared.name]) or f"object {number}"
    words = (row[column] for column in compared.further if column != "z")
    reason = _reason(row, state, number) if "evidence" in compared.further else "; ".join(filter(None, words))
    asks = state in compared.asked
    return Entry(name, kind, state, x, y, z if math.isfinite(z) else None, number, reason, asks)


def _reason(row: dict[str, str], state: str, number: int) -> str:
    """Return why an entry of a register has its state."""
    return {
        "not found": f"{row['rays']} rays through its place",
        "different kind": f"{row['object_kind']} {number} stands there",
        "moved": f"{row['object_kind']} {number} stands {row['distance']} m away",
        "new": f"{row['object_kind']} {number} has no entry",
    }.get(state, row["evidence"])


def check_entries(corrections: Iterable[Correction], folder: Path) -> None:
    """Raise ParameterError for a decision about a state that the present tables do not have."""
    checks = [correction for correction in corrections if correction.action == "check"]
    present = compared_entries(folder)[0] if checks else {}
    for check in checks:
        wanted = check.payload
        if not any(is_about(wanted, check.kind, entry) for entry in present.get(wanted["table"], ())):
            raise ParameterError(
                f"{folder / COMPARED[wanted['table']].file} has no {check.kind} {wanted['entry']} with the state "
                f"{wanted['state']!r}: its table is another now; reload the page"
            )


def is_about(given: Mapping[str, Any], kind: str | None, entry: Entry) -> bool:
    """Return whether the payload of a decision is about the state of an entry."""
    same = (given["entry"], kind, given["state"]) == (entry.name, entry.kind, entry.state)
    return same and math.hypot(given["x"] - entry.x, given["y"] - entry.y) <= _SAME_PLACE


def checked_of(name: str, entries: Sequence[Entry], decisions: Iterable[Decision]) -> dict[str, str]:
    """Return what the last decision in force says of the state of each entry: right or wrong.

    A decision holds for an entry of its name, kind and state within a metre of its place.
    """
    last = {}
    for decision in decisions:
        given = decision.correction
        if given.action == "check" and given.payload["table"] == name:
            last[given.payload["entry"], given.payload["state"]] = given
    return {
        entry.name: str(found.payload["checked"])
        for entry in entries
        if (found := last.get((entry.name, entry.state))) and is_about(found.payload, found.kind, entry)
    }
