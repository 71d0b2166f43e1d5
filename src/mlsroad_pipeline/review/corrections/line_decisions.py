"""Lines of an inventory after the decisions about them: status, cut, joined, moved and new lines."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.inventory.lines.extraction import (
    LINE_FIELDS,
    line_fields_of_kind,
    line_row,
)
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage
from mlsroad_pipeline.review.corrections.decisions import LINE_ACTIONS, Correction, Decision
from mlsroad_pipeline.review.corrections.store import has_corrections, open_corrections

MOVED = 0.5
"""Largest distance of the first vertex of a line that is found again, metres."""

_SAME = 0.01  # metres
_STATUS = {"accept_line": "accepted", "reject_line": "rejected", "kind_line": "changed", "shape_line": "moved"}
_STATUS |= {"cut_line": "cut", "join_lines": "joined", "add_line": "added"}
_ALONG = ("score", "width", "contrast", "pattern")
"""Measures that hold for the parts of a line too; the others are unknown after a cut."""


@dataclass
class LineStates:
    """Result of the decisions about lines."""

    status: dict[int, str] = field(default_factory=dict)  # Status of decided lines by number
    rows: dict[int, dict[str, Any]] = field(default_factory=dict)  # Lines that decisions have changed or made
    gone: set[int] = field(default_factory=set)  # Lines that were joined into others
    unmatched: list[Decision] = field(default_factory=list)  # Decisions about lines that are not found

    def apply(self, lines: pd.DataFrame) -> pd.DataFrame:
        """Return the lines after the decisions, also the rejected ones, in the order of their numbers."""
        kept = lines[~lines["line_id"].isin([*self.gone, *self.rows])]
        new = pd.DataFrame(list(self.rows.values()), columns=list(LINE_FIELDS))
        types = {name: entry.dtype for name, entry in LINE_FIELDS.items()}
        parts = [part.astype(types) for part in (kept[list(LINE_FIELDS)], new) if len(part)]
        joined = pd.concat(parts, ignore_index=True) if parts else kept
        return joined.sort_values("line_id", kind="stable", ignore_index=True).round(3)


class _Present:
    """Lines as they are while decisions are applied: numbers, kinds and first vertices, by cells of `MOVED`."""

    def __init__(self, lines: pd.DataFrame) -> None:
        self._lines: dict[int, tuple[str, float, float]] = {}
        self._cells: dict[tuple[str, int, int], set[int]] = {}
        self.last = 0
        places = zip(*(lines[name].tolist() for name in ("line_id", "kind", "x", "y")), strict=True)
        for number, kind, x, y in places:
            self.put(int(number), str(kind), (x, y))

    def find(self, kind: str, given: Mapping[str, Any]) -> int | None:
        """Return the number of the line of a kind that begins at a place; of several the one of that number."""
        _, i, j = _cell(kind, given["x"], given["y"])
        near = [n for a in (-1, 0, 1) for b in (-1, 0, 1) for n in self._cells.get((kind, i + a, j + b), ())]
        apart = {n: math.dist(self._lines[n][1:], (given["x"], given["y"])) for n in near}
        found = [n for n, distance in apart.items() if distance <= MOVED]
        return min(found, key=lambda n: (apart[n] > _SAME, n != given["line"], apart[n], n), default=None)

    def put(self, number: int, kind: str, place: Sequence[float]) -> None:
        """Add a line, or replace the one of its number."""
        self.drop(number)
        self._lines[number] = kind, place[0], place[1]
        self._cells.setdefault(_cell(kind, place[0], place[1]), set()).add(number)
        self.last = max(self.last, number)

    def drop(self, number: int) -> None:
        """Remove a line."""
        if number in self._lines:
            self._cells[_cell(*self._lines.pop(number))].discard(number)


def _cell(kind: str, x: float, y: float) -> tuple[str, int, int]:
    return kind, math.floor(x / MOVED), math.floor(y / MOVED)


def line_states(decisions: Sequence[Decision], lines: pd.DataFrame, trajectory: Trajectory | None = None) -> LineStates:
    """Return the lines after the decisions in force; they are found by kind and first vertex, one after the other.

    `lines` has the columns of `LINE_FIELDS`. New lines are numbered after all others in the order of the decisions; the
    first part of a cut line keeps its number, and so does the first of joined ones.
    """
    if not decisions:
        return LineStates()
    present, found = _Present(lines), LineStates()
    rows = dict(zip(lines["line_id"].tolist(), range(len(lines)), strict=True))
    for decision in decisions:
        given, kind = decision.correction, str(decision.correction.kind)
        number = present.last + 1 if given.action == "add_line" else present.find(kind, given.payload)
        if number is None:
            found.unmatched.append(decision)
            continue
        if given.action == "join_lines":
            other = present.find(str(given.payload["other"].get("kind", kind)), given.payload["other"])
            if other is None or other == number:
                found.unmatched.append(decision)
                continue
            present.drop(other)
            found.gone.add(other)
            found.rows.pop(other, None)
            found.status.pop(other, None)
        status = _STATUS[given.action]
        if status != "moved" or number not in found.status:  # a line that was accepted and moved stays accepted
            found.status[number] = status
        if given.action not in ("accept_line", "reject_line"):
            before = found.rows.get(number) or (_row(lines, rows[number]) if number in rows else {})
            _change(found, present, number, given, before, trajectory)
    return found


def corrected_lines(lines: pd.DataFrame | None, folder: Path, trajectory: Trajectory | None) -> pd.DataFrame | None:
    """Return lines after the decisions in an output folder, also rejected ones, with the column `status`."""
    if lines is None:
        return None
    found = LineStates()
    if has_corrections(folder):
        with open_corrections(folder, write=False) as store:
            decisions = [d for d in store.current() if d.correction.action in LINE_ACTIONS]
        found = line_states(decisions, lines, trajectory)
    table = found.apply(lines)
    return table.assign(status=[found.status.get(number, "") for number in table["line_id"].tolist()])


def lost_lines(decisions: Sequence[Decision], folder: Path) -> list[Decision]:
    """Return the decisions about lines that the inventory of an output folder does not have."""
    path = folder / "inventory.gpkg"
    lines = read_geopackage(path).lines if decisions and path.is_file() else None
    return [] if lines is None else line_states(decisions, lines).unmatched


def _row(lines: pd.DataFrame, row: int) -> dict[str, Any]:
    return {str(name): value for name, value in lines.iloc[row].items()}


def _change(
    found: LineStates,
    present: _Present,
    number: int,
    given: Correction,
    before: Mapping[str, Any],
    trajectory: Trajectory | None,
) -> None:
    """Write the rows of a decision that changes the kind or the vertices of lines."""
    if given.action == "kind_line":
        kind = str(given.payload["to"])
        fields = line_fields_of_kind(kind)
        blank = {n: "" if entry.dtype == "str" else np.nan for n, entry in LINE_FIELDS.items() if n not in fields}
        found.rows[number] = {**before, **blank, "kind": kind}
        present.put(number, kind, (before["x"], before["y"]))
        return
    kept = {"shape_line": tuple(LINE_FIELDS), "cut_line": _ALONG}.get(given.action, ())
    measures = {
        n: v for n, v in before.items() if n in kept and n not in ("line_id", "kind", "length", "x", "y", "line")
    }
    for k, part in enumerate(given.payload["parts"]):
        own = present.last + 1 if k else number
        vertices = np.array(part, np.float64)
        row = line_row(str(given.kind), vertices, trajectory, **measures)
        found.rows[own] = row | {"line_id": own}
        found.status[own] = found.status[number]
        present.put(own, str(given.kind), vertices[0, :2].tolist())
