"""Corrections of a labelled survey: the actions, their arguments and their checks."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS

LINE_ACTIONS = ("accept_line", "reject_line")
"""Actions about a line of the inventory: a kerb, a wire or a marking."""

ACTIONS = ("accept", "reject", "other_kind", "merge", "split", "move_base", "add", "paint", *LINE_ACTIONS)
"""Actions of a user: `paint` changes points, `add` adds a missing object, the others change one object or line."""

FARTHEST = 20.0
"""Largest move of a base point, metres."""

_FARTHEST_PLACE = 1e8  # from the origin of the system, metres
_LONGEST_NAME = 200  # of a kind or class, characters
_LONGEST_TEXT = 10_000_000  # of a payload as JSON, characters


@dataclass(frozen=True)
class Correction:
    """One decision of a user."""

    action: str  # One of `ACTIONS`
    object_id: int | None = None  # Number of the object in the inventory; none for `add`, `paint` and lines
    kind: str | None = None  # With `other_kind` and `add` the right kind (pole, sign, vehicle, tree); that of a line
    # JSON values. `accept`, `other_kind`, `add`: optionally `class`, the class of its points. `reject`: optionally
    # `class`, that of its points. `merge`: `objects`, the numbers of the objects that belong to this one. `split`:
    # `bases`, the base points of its parts, each x, y, z. `move_base` and `add`: `x`, `y`, `z`. `paint`: `file`, the
    # name of the labelled file, `points`, the numbers of its points from 0, `class`, and optionally `n_points`, the
    # number of points of the file. Lines: `line`, its number, and `x`, `y`, its first vertex.
    payload: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arguments of the action."""
        if self.action not in ACTIONS:
            raise ParameterError(f"correction: unknown action {self.action!r}, known are {', '.join(ACTIONS)}")
        if self.action in ("add", "paint", *LINE_ACTIONS):
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
            place = [given.get("x"), given.get("y"), 0.0]
            self._need(_is_place(place) and _is_number(given.get("line")), "line, x, y must be numbers")
            self._need(self.kind is not None, "kind must be given")
        elif self.action == "paint":
            points = given.get("points")
            right = bool(_entries(points)) and all(_is_number(point, least=0) for point in _entries(points))
            self._need(right, "points must be numbers of points from 0")
            file = given.get("file")
            self._need(isinstance(file, str) and file != "", f"file must be the name of a file, got {file!r}")
            self._need(named, "class must be given")

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
    """Check kind, class, places and texts of a new decision, of the page and of an import.

    Parameters
    ----------
    correction : Correction
        The decision.
    place : tuple of float, optional
        Base point x, y of its object.
    classes : collection of str, optional
        Known names of classes and kinds.

    Raises
    ------
    ParameterError
        If a value is unknown, cannot be written or is implausible.
    """
    for what, text in (("kind", correction.kind), ("class", correction.payload.get("class"))):
        correction._need(
            text is None or _is_name(text),
            f"{what} '{printable(text)}' is not a name of at most {_LONGEST_NAME} printable characters",
        )
    kinds = LINE_KINDS if correction.action in LINE_ACTIONS else KINDS
    kind, name = correction.kind, correction.payload.get("class")
    correction._need(kind is None or kind in kinds, f"unknown kind {kind!r}: use {', '.join(kinds)}")
    correction._need(
        name is None or classes is None or name in classes,
        f"unknown class {name!r}: use one of {', '.join(sorted(classes or ()))}",
    )
    given = correction.payload
    places = [[given[axis] for axis in "xyz" if axis in given], *(given.get("bases") or ())]
    far = next((p for p in places if any(abs(float(value)) > _FARTHEST_PLACE for value in p)), None)
    correction._need(far is None, f"the place {far} is more than {_FARTHEST_PLACE:g} m from the origin")
    if correction.action == "move_base" and place is not None:
        apart = max(abs(float(given[axis]) - own) for axis, own in zip("xy", place, strict=True))
        correction._need(
            apart <= FARTHEST, f"object {correction.object_id} was moved by {apart:.0f} m, allowed are {FARTHEST:.0f} m"
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
