"""Labelled LAZ with the decisions: classes of painted points and of changed objects, numbers of objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.files import LAZ_CHUNK, atomic_file
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, OBJECT
from mlsroad_pipeline.formats.las.records import RecordReader
from mlsroad_pipeline.formats.las.writer import RecordWriter
from mlsroad_pipeline.review.corrections.answers import NamedClasses
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.review.corrections.states import States
from mlsroad_pipeline.review.delivery.corrected_objects import new_rows
from mlsroad_pipeline.review.page_server.cloud_files import CloudFile, CloudFiles
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.painted import Painted

UNCLASSIFIED = 1
"""Code of the points of rejected objects, whose class nobody gave."""

_THREADS = 2
_RANGE = 20 * LAZ_CHUNK


class ClassCodes:
    """Codes of class names as users give them: names of the labelled files, of the model, of its schemes, and kinds."""

    def __init__(self, output: OutputFolder) -> None:
        names = output.class_names()
        self._codes = {name: code for code, name in sorted(names.items(), reverse=True)}
        labelled = LabelledOutput(output.path, output.run)
        scheme = None if labelled.written_scheme is not None else labelled.model_scheme(names)
        self._named = None if scheme is None else NamedClasses(scheme, labelled.schemes)

    def code(self, name: str) -> int | None:
        """Return the code of a class; None where the labelled files have none, or several."""
        if name in self._codes or self._named is None:
            return self._codes.get(name)
        try:
            allowed = self._named.allowed(name)
        except DataError:  # a name of another model
            return None
        codes = {int(code) for code, own in zip(self._named.scheme.codes(), allowed, strict=True) if own}
        return codes.pop() if len(codes) == 1 else None


def object_codes(objects: pd.DataFrame, states: States, codes: ClassCodes) -> tuple[NDArray[np.int16], set[str]]:
    """Return the class code that decisions give to each object, by number, -1 without one.

    The second value are classes that the labelled files have no code for.
    """
    given = np.full(int(objects["object_id"].max()) + 1 if len(objects) else 1, -1, np.int16)
    listed = dict(zip(objects["object_id"].tolist(), objects["class"].astype(str), strict=True))
    unknown = set()
    for number, state in states.of_objects.items():
        owner = states.of_objects[state.get("merged_into", number)]
        final = owner["checked_class"]
        if final and final != listed[number]:
            code = codes.code(final)
            given[number] = -1 if code is None else code
            unknown |= {final} if code is None else set()
        elif owner["status"] == "rejected" and not final:
            given[number] = UNCLASSIFIED
    return given, unknown


@dataclass
class PointChanges:
    """Changes of the points of objects, by the number of the object in the labelled files."""

    numbers: NDArray[np.uint32]  # Number that each object has after the decisions; 0 for rejected ones
    codes: NDArray[np.int16]  # Class code of its points; -1 keeps them
    split: dict[int, tuple[NDArray[np.float64], list[int]]] = field(default_factory=dict)  # Bases and numbers
    unknown: set[str] = field(default_factory=set)  # Given classes that the labelled files have no code for

    @classmethod
    def of(cls, objects: pd.DataFrame, states: States, codes: ClassCodes, listed: Sequence[int]) -> PointChanges:
        """Return the changes of decisions; `listed` are the numbers of the objects that are delivered."""
        given, unknown = object_codes(objects, states, codes)
        every = np.arange(len(given))
        kept = np.isin(every, listed)
        changes = cls(np.where(kept, every, 0).astype(np.uint32), given, unknown=unknown)
        for number, state in states.of_objects.items():
            owner = state.get("merged_into", number)
            if owner != number:
                changes.numbers[number] = owner if kept[owner] else 0
        changes._split(objects, states, set(listed))
        return changes

    def _split(self, objects: pd.DataFrame, states: States, listed: set[int]) -> None:
        parts = new_rows(objects, states)
        for number, state in states.of_objects.items():
            if "bases" not in state or "merged_into" in state:
                continue
            own = [row["object_id"] for row in parts if row["of"] == number]
            first = [0] if state["status"] == "rejected" else []
            numbers = [n if n in listed else 0 for n in (*first, *own)]
            self.split[number] = np.array(state["bases"], dtype=np.float64), numbers

    def apply(self, records: NDArray, xyz: NDArray[np.float64], painted: Painted) -> None:
        """Change records in place; `xyz` are their coordinates in metres, `painted` has rows from 0."""
        before, number = records[OBJECT], np.minimum(records[OBJECT], len(self.numbers) - 1)
        foreign = before != number  # a number that the inventory does not have stays
        code = np.where(foreign, -1, self.codes[number])
        now = np.where(foreign, before, self.numbers[number])
        for split, (bases, numbers) in self.split.items():
            rows = np.flatnonzero(before == split)
            apart = ((xyz[rows, None, :2] - bases[None, :, :2]) ** 2).sum(axis=2)
            now[rows] = np.array(numbers)[apart.argmin(axis=1)]
        of_object = np.where(code >= 0, code, records[CLASS])
        now[painted.rows] = np.where(painted.codes == of_object[painted.rows], now[painted.rows], 0)
        code[painted.rows] = painted.codes
        given = code >= 0
        records[CLASS][given] = code[given]
        records[OBJECT] = now
        if CONFIDENCE in (records.dtype.names or ()):
            records[CONFIDENCE][given] = code[given] != UNCLASSIFIED


def painted_points(clouds: CloudFiles, states: States, codes: ClassCodes) -> Painted:
    """Return the painted points of all files, by their row in the survey."""
    strokes = []
    for decision in states.painted:
        given = decision.correction
        code = codes.code(given.payload["class"])
        for file in clouds.files:
            if code is not None and given.paints(file.name, file.header.n_points):
                strokes.append((np.asarray(given.payload["points"], np.int64) + file.first, code))
    return Painted.of(strokes)


def write_corrected_cloud(file: CloudFile, target: Path, changes: PointChanges, painted: Painted) -> None:
    """Write a labelled file with the changes; all other attributes and the order of the points stay."""
    header, own = file.header, painted.part(file.first, file.first + file.header.n_points)
    if OBJECT not in _names(file):
        raise DataError(f"{file.path} has no {OBJECT}: label the survey again")
    with RecordReader(file.path, header, n_threads=_THREADS) as reader, atomic_file(target) as stream:
        writer = RecordWriter(stream, header, compress=True, n_threads=_THREADS)
        for start in range(0, header.n_points, _RANGE):
            records = reader.read(start, start + _RANGE)
            stored = np.column_stack([records[axis] for axis in "XYZ"])
            xyz = (stored * header.scale + header.offset) * file.metres
            changes.apply(records, xyz, own.part(start, start + len(records)))
            writer.write(records)
        writer.close()


def _names(file: CloudFile) -> Mapping[str, Any]:
    with RecordReader(file.path, file.header) as reader:
        return dict.fromkeys(reader.dtype.names or ())
