"""Corrections of a labelled survey: the actions, their arguments and their checks."""

import json
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.review.compared_entries import CHECKED, COMPARED

LINE_SHAPES = {"shape_line": 1, "cut_line": 2, "join_lines": 1, "add_line": 1}
"""Actions that give lines other vertices, to the number of lines that they leave."""

LINE_ACTIONS = ("accept_line", "reject_line", "kind_line", *LINE_SHAPES)
"""Actions about a line of the inventory: a kerb, a wire or a marking."""

_OBJECT_ACTIONS = ("accept", "reject", "other_kind", "merge", "split", "move_base")
ACTIONS = (*_OBJECT_ACTIONS, "add", "paint", "note", "check", *LINE_ACTIONS)
"""Actions of a user: `paint` changes points, `add` adds a missing object, `check` judges a compared state, the others
change one object or line."""

FARTHEST = 20.0
"""Largest move of a base point, metres."""

_FARTHEST_PLACE = 1e8  # from the origin of the system, metres
_LONGEST_NAME = 200  # of a kind or class, characters
_LONGEST_TEXT = 10_000_000  # of a payload as JSON, characters
_MOST_VERTICES = 20_000  # of the lines of a decision


@dataclass(frozen=True)
class Correction:
    """One decision of a user."""

    action: str  # One of `ACTIONS`
    object_id: int | None = None  # Number of the object in the inventory; none for `add`, `paint`, `check`, lines
    kind: str | None = None  # With `other_kind` and `add` the right kind (pole, sign, vehicle, tree); that of a line
    # JSON values. `accept`, `other_kind`, `add`: optionally `class`, the class of its points. `reject`: optionally
    # `class`, that of its points. `merge`: `objects`, the numbers of the objects that belong to this one. `split`:
    # `bases`, the base points of its parts, each x, y, z. `move_base` and `add`: `x`, `y`, `z`. `paint`: `file`, the
    # name of the labelled file, `points`, the numbers of its points from 0, `class`, and optionally `n_points`, the
    # number of points of the file. `note`: `note` and `attributes`, texts that replace those of before, of the object
    # or of the one that the decision `added` has added; `add` may have them too. Lines, by their present kind: `line`,
    # its number, and `x`, `y`, its first vertex, but for `add_line`; `kind_line`: `to`, the right kind; `LINE_SHAPES`:
    # `parts`, the vertices x, y, z of each line; `join_lines`: `other`, with `line`, `kind`, `x`, `y`. `check`, by the
    # kind of the entry: `table` of `COMPARED`, `entry`, its name, `x`, `y`, `state`, and `checked`, right or wrong.
    payload: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arguments of the action."""
        if self.action not in ACTIONS:
            raise ParameterError(f"correction: unknown action {self.action!r}, known are {', '.join(ACTIONS)}")
        if self.action in ("add", "paint", "check", *LINE_ACTIONS) or self._is_about_added:
            self._need(self.object_id is None, "object_id must be left out")
        else:
            self._need(_is_number(self.object_id), f"object_id must be a number from 1, got {self.object_id!r}")
        kind = self.kind
        self._need(kind is None or (isinstance(kind, str) and kind != ""), f"kind must be a name, got {kind!r}")
        self._need(isinstance(self.payload, Mapping), f"payload must be a mapping, got {self.payload!r}")
        text = self._text()
        self._need(len(text) <= _LONGEST_TEXT, f"the payload has {len(text)} characters, allowed {_LONGEST_TEXT}")
        self._check_payload()

    def _check_payload(self) -> None:
        given = self.payload
        name = given.get("class")
        named = isinstance(name, str) and name != ""
        self._need(name is None or named, f"class must be a name, got {name!r}")
        if self.action == "other_kind":
            self._need(self.kind is not None or named, "kind (or class in the payload) must name what it is")
        elif self.action == "merge":
            others = given.get("objects")
            right = bool(_entries(others)) and all(_is_number(number) for number in _entries(others))
            self._need(
                right and self.object_id not in _entries(others), f"objects must be numbers of others, got {others!r}"
            )
        elif self.action == "split":
            bases = given.get("bases")
            right = len(_entries(bases)) > 1 and all(_is_place(base) for base in _entries(bases))
            self._need(right, f"bases must be two or more places x, y, z, got {bases!r}")
        elif self.action in ("move_base", "add"):
            place = [given.get(axis) for axis in "xyz"]
            self._need(_is_place(place), f"x, y, z must be numbers, got {place!r}")
            self._need(self.action == "move_base" or self.kind is not None, "kind must be given")
        elif self.action in LINE_ACTIONS:
            self._check_line()
        elif self.action == "check":
            self._check_entry()
        elif self.action == "note":
            added = given.get("added", 1)
            self._need(_is_number(added), f"added must be the number of a decision, got {added!r}")
        elif self.action == "paint":
            points = given.get("points")
            right = bool(_entries(points)) and all(_is_number(point, least=0) for point in _entries(points))
            self._need(right, "points must be numbers of points from 0")
            file = given.get("file")
            self._need(isinstance(file, str) and file != "", f"file must be the name of a file, got {file!r}")
            self._need(named, "class must be given")

        if self.action in ("note", "add"):
            check_note(given, self._need)

    def _check_line(self) -> None:
        given = self.payload
        self._need(self.kind is not None, "kind must be given")
        for line in () if self.action == "add_line" else (given, given.get("other", given)):
            place = [line.get("x"), line.get("y"), 0.0] if isinstance(line, Mapping) else []
            self._need(_is_place(place) and _is_number(line.get("line")), "line, x, y must be numbers")
        if self.action == "join_lines":
            self._need("other" in given, "other must be the line that belongs to it")
        elif self.action == "kind_line":
            self._need(isinstance(given.get("to"), str), f"to must be the right kind, got {given.get('to')!r}")
        if self.action not in LINE_SHAPES:
            return
        parts, number = _entries(given.get("parts")), LINE_SHAPES[self.action]
        right = len(parts) == number and all(len(_entries(part)) > 1 for part in parts)
        right = right and sum(map(len, parts)) <= _MOST_VERTICES and all(_is_place(v) for part in parts for v in part)
        self._need(right, f"parts must be {number} lists of two or more vertices x, y, z, {_MOST_VERTICES} at most")

    def _check_entry(self) -> None:
        given = self.payload
        table, entry, state, checked = (given.get(name) for name in ("table", "entry", "state", "checked"))
        self._need(isinstance(table, str) and table in COMPARED, f"table must be one of {', '.join(COMPARED)}")
        self._need(isinstance(entry, str) and entry != "" and _is_name(entry), "entry must be the name of an entry")
        place = [given.get("x"), given.get("y"), 0.0]
        self._need(self.kind is not None and _is_place(place), "kind, x, y must be given")
        self._need(state in COMPARED[str(table)].states, f"unknown state {state!r} of {table}")
        self._need(checked in CHECKED, f"checked must be {' or '.join(CHECKED)}, got {checked!r}")

    @property
    def _is_about_added(self) -> bool:
        return self.action == "note" and isinstance(self.payload, Mapping) and "added" in self.payload

    def _text(self) -> str:
        try:
            return json.dumps(dict(self.payload), sort_keys=True, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ParameterError(f"correction {self.action!r}: the payload is not JSON: {error}") from error

    def _need(self, right: bool, message: str) -> None:
        if not right:
            raise ParameterError(f"correction {self.action!r}: {message}")

    def paints(self, file: str, n_points: int) -> bool:
        """Return whether it is about points of a labelled file with a number of points."""
        given = self.payload
        if self.action != "paint" or given["file"] not in (file, PurePath(file).name):
            return False
        return given.get("n_points", n_points) == n_points and max(given["points"]) < n_points

    @property
    def checked_class(self) -> str:
        """Class that the user gave, else the kind; empty if neither."""
        return str(self.payload.get("class") or self.kind or "")

    @property
    def described(self) -> str:
        """Content of the decision in a few words, without the number of the object."""
        given = self.payload
        if self.action == "paint":
            return f"{len(given['points']):,} points: {given['class']}"
        if self.action == "merge":
            return "with " + ", ".join(map(str, given["objects"]))
        if self.action == "note":
            typed = (f"{name}: {value}" for name, value in given.get("attributes", {}).items())
            return "; ".join(filter(None, (given.get("note"), *typed)))
        if self.action == "check":
            return f"{given['table']} {given['entry']} {given['state']}: {given['checked']}"
        if self.action not in LINE_ACTIONS:
            return self.checked_class
        own = f"{self.kind} {given['line']}" if "line" in given else str(self.kind)
        with_other = f" with {given['other']['line']}" if "other" in given else ""
        return f"{own}{with_other}{' to ' + str(given['to']) if 'to' in given else ''}"


@dataclass(frozen=True)
class Anchor:
    """Object that a decision is about, as it was when the decision was made."""

    inventory: str  # Digest of the numbers and places of all objects
    # kind, name: its kind and its class
    kind: str
    name: str
    # x, y, z: its base point
    x: float
    y: float
    z: float
    point_count: int  # Number of its points
    nearest: float | None = None  # Distance in plan to the nearest other object of its kind, metres; None without one


@dataclass(frozen=True)
class Decision:
    """A correction as it is stored."""

    identifier: int  # Number in the store, from 1
    made: str  # Time in UTC, ISO 8601
    who: str  # Name of the user
    correction: Correction  # The correction
    anchors: Mapping[int, Anchor]  # The objects that it names, by their number at that time
    undone: str = ""  # Time at which it was undone, empty while it is in force


def check_values(
    correction: Correction, *, place: tuple[float, float] | None = None, classes: Collection[str] | None = None
) -> None:
    """Check kind, class, places and texts of a new decision, of the page and of an import."""
    for what, text in (("kind", correction.kind), ("class", correction.payload.get("class"))):
        correction._need(
            text is None or _is_name(text),
            f"{what} '{printable(text)}' is not a name of at most {_LONGEST_NAME} printable characters",
        )
    kinds: Sequence[str] = LINE_KINDS if correction.action in LINE_ACTIONS else KINDS
    if correction.action == "check":
        kinds = COMPARED[correction.payload["table"]].kinds
    kind, name = correction.kind, correction.payload.get("class")
    to = correction.payload.get("to", kind)
    correction._need(correction.action != "kind_line" or to in kinds, f"unknown kind {to!r}: use {', '.join(kinds)}")
    correction._need(kind is None or kind in kinds, f"unknown kind {kind!r}: use {', '.join(kinds)}")
    correction._need(
        name is None or classes is None or name in classes,
        f"unknown class {name!r}: use one of {', '.join(sorted(classes or ()))}",
    )
    given = correction.payload
    places = [[line[axis] for axis in "xyz" if axis in line] for line in (given, given.get("other", {}))]
    places += given.get("bases") or ()
    places += [vertex for part in given.get("parts", ()) for vertex in part]
    far = next((p for p in places if any(abs(float(value)) > _FARTHEST_PLACE for value in p)), None)
    correction._need(far is None, f"the place {far} is more than {_FARTHEST_PLACE:g} m from the origin")
    if correction.action == "move_base" and place is not None:
        apart = max(abs(float(given[axis]) - own) for axis, own in zip("xy", place, strict=True))
        correction._need(
            apart <= FARTHEST, f"object {correction.object_id} was moved by {apart:.0f} m, allowed are {FARTHEST:.0f} m"
        )


_NAME_OF_ATTRIBUTE = re.compile(r"[^\W\d_]\w{0,39}")
_LONGEST_NOTE, _LONGEST_VALUE, _MOST_ATTRIBUTES = 1000, 200, 50


def check_note(given: Mapping[str, Any], need: Callable[[bool, str], None]) -> None:
    """Check the note and the attributes of an object; `need` raises where its first argument is false."""
    note, attributes = given.get("note", ""), given.get("attributes", {})
    need(
        isinstance(note, str) and len(note) <= _LONGEST_NOTE and note.isprintable(),
        f"the note must be a line of at most {_LONGEST_NOTE} printable characters",
    )
    right = isinstance(attributes, Mapping) and len(attributes) <= _MOST_ATTRIBUTES
    need(right, f"attributes must be at most {_MOST_ATTRIBUTES} names with texts")
    for name, value in attributes.items():
        shown = printable(str(name))
        need(
            isinstance(name, str) and name == name.lower() and _NAME_OF_ATTRIBUTE.fullmatch(name) is not None,
            f"'{shown}' is not the name of an attribute: a small letter, then up to 39 small letters, digits and _",
        )
        need(
            isinstance(value, str) and 0 < len(value) <= _LONGEST_VALUE and value.isprintable(),
            f"attribute '{shown}' must have a text of 1 to {_LONGEST_VALUE} printable characters",
        )


def _is_name(text: str) -> bool:
    return len(text) <= _LONGEST_NAME and text.isprintable()


def named_objects(correction: Correction) -> list[int]:
    """Return the numbers of the objects that a correction names, its own first."""
    own = [] if correction.object_id is None else [correction.object_id]
    return own + [int(number) for number in correction.payload.get("objects", ())]


def _is_number(value: object, *, least: int = 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value < 2**53


def _entries(value: object) -> Sequence[Any]:
    """Return a list; an empty one for other values."""
    return value if isinstance(value, Sequence) and not isinstance(value, str | bytes) else ()


def _is_place(value: object) -> bool:
    return (
        isinstance(value, Sequence)
        and len(value) == 3
        and all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in value)
    )
