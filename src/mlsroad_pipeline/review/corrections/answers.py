"""Points that decisions are about, and the classes that each decision allows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.codings import CODE_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, UnknownClassError
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.review.corrections.decisions import Decision
from mlsroad_pipeline.review.corrections.states import States

LOOKUP_LENGTH = 15
"""Characters of a class name in the header of a LAZ file."""


_NO_CLASS = (0, 1, 7, 18)
"""Codes of points without a class: never classified, unclassified, noise."""


def classes_of_codes(scheme: ClassScheme) -> dict[int, list[str]]:
    """Return the classes of a scheme that are written as each LAS code; none for unclassified points and noise."""
    found: dict[int, list[str]] = {}
    for name, code in zip(scheme.classes, scheme.asprs, strict=True):
        found.setdefault(code, []).append(name)
    return found | {code: [] for code in _NO_CLASS}


class NamedClasses:
    """Classes of a model by the names that users give.

    Known are the classes of the model, those of configured schemes that are unions of them, and the names of the LAS
    codes that the model writes; of all of these also the first 15 characters, as a LAZ file names them.
    """

    def __init__(self, scheme: ClassScheme, schemes: Mapping[str, Any]) -> None:
        self.scheme = scheme
        own = np.eye(len(scheme), dtype=np.bool_)
        self._sets: dict[str, NDArray[np.bool_]] = {text: own[label] for label, text in enumerate(scheme.classes)}
        for name in ("common", *schemes):
            self._add(name, schemes)
        standard = schemes.get("asprs", {}).get("classes", {})
        for code, names in classes_of_codes(scheme).items():
            group = np.isin(scheme.classes, names)
            others = [name for name, spec in standard.items() if spec["asprs"] == code]
            for text in (CODE_NAMES.get(code, ""), *others, "/".join(names)):
                self._sets.setdefault(text, group)
        self._sets.pop("", None)
        self._cut = {text[:LOOKUP_LENGTH]: group for text, group in reversed(self._sets.items())}

    def _add(self, name: str, schemes: Mapping[str, Any]) -> None:
        if name not in schemes:
            return
        coarse = ClassScheme.from_config(name, schemes[name])
        try:
            group = self.scheme.coarsen(coarse)
        except (ParameterError, UnknownClassError):  # a scheme that divides the classes in another way
            return
        for label, text in enumerate(coarse.classes):
            if (group == label).any():
                self._sets.setdefault(text, group == label)

    @property
    def names(self) -> tuple[str, ...]:
        """All names that are known."""
        return (*self._sets, *self._cut)

    def allowed(self, name: str) -> NDArray[np.bool_]:
        """Return the classes of a name, none for points without a class; DataError if it is unknown."""
        found = self._sets.get(name, self._cut.get(name))
        if found is None:
            raise DataError(f"class {name!r} is unknown to the model: use one of {', '.join(self._sets)}")
        return found


@dataclass(frozen=True)
class FileAnswers:
    """Answers about the points of one file."""

    answer: NDArray[np.int64]  # Number of the answer of each point, -1 without one
    classes: list[NDArray[np.bool_]]  # Classes that each answer allows
    # What each answer is about: ``("object", number)`` or ``("stroke", identifier)``. An object can have points in
    # several files.
    about: list[tuple[str, int]]


def object_classes(states: States, table: Mapping[int, str], named: NamedClasses) -> dict[int, NDArray[np.bool_]]:
    """Return the classes that decided objects allow; `table` has the class of each object in the inventory."""
    allowed: dict[int, NDArray[np.bool_]] = {}
    for number, state in states.of_objects.items():
        own = table.get(number)
        if own is None or (state["checked_class"] and not named.allowed(state["checked_class"]).any()):
            continue
        if state["status"] == "rejected" and not state["checked_class"]:
            allowed[number] = ~named.allowed(own)
        else:
            allowed[number] = named.allowed(state["checked_class"] or own)
    return allowed


def unmatched_strokes(strokes: Sequence[Decision], files: Mapping[str, int]) -> list[Decision]:
    """Return the strokes about points of none of the files; `files` has the number of points of each."""
    return [
        decision
        for decision in strokes
        if not any(decision.correction.paints(name, n_points) for name, n_points in files.items())
    ]


def files_of(strokes: Sequence[Decision], folder: Path) -> dict[str, int]:
    """Return the number of points of the labelled files in a folder that strokes name."""
    names = {decision.correction.payload["file"] for decision in strokes}
    return {name: read_header(folder / name).n_points for name in names if (folder / name).is_file()}


def answers_of_file(
    name: str,
    object_id: NDArray[np.integer],
    states: States,
    objects: Mapping[int, NDArray[np.bool_]],
    named: NamedClasses,
) -> FileAnswers:
    """Return the answers about the points of a labelled file; painted points come before objects.

    Strokes about a file of this name with another number of points are left out.
    """
    answer = np.full(len(object_id), -1, dtype=np.int64)
    classes: list[NDArray[np.bool_]] = []
    about: list[tuple[str, int]] = []
    for number, allowed in objects.items():
        rows = np.flatnonzero(object_id == number)
        if len(rows):
            answer[rows] = len(classes)
            classes.append(allowed)
            about.append(("object", number))
    for decision in states.painted:
        given = decision.correction.payload
        if not decision.correction.paints(name, len(object_id)):
            continue
        rows = np.asarray(given["points"], dtype=np.int64)
        allowed = named.allowed(given["class"])
        answer[rows] = len(classes) if allowed.any() else -1
        if allowed.any():
            classes.append(allowed)
            about.append(("stroke", decision.identifier))
    return FileAnswers(answer, classes, about)
