"""Store of corrections: a SQLite file in the output folder of a labelled survey.

Each decision is written and synced to the disk before `add` returns. Decisions are never changed: `undo` marks one.
The file outlives later runs of `label` into the same folder; decisions find their objects again by kind and place.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.review.corrections import store_file
from mlsroad_pipeline.review.corrections.decisions import Anchor, Correction, Decision, check_values, named_objects
from mlsroad_pipeline.review.corrections.listed_objects import INVENTORIES, ListedObjects, read_objects
from mlsroad_pipeline.review.corrections.states import ObjectState, fold_states

NAME = "corrections.sqlite"
"""Name of the store in an output folder."""

_READ = f"SELECT id, {store_file.FIELDS}, checksum FROM decisions"


class CorrectionStore:
    """Decisions about one output folder; safe for several threads and processes."""

    def __init__(self, folder: Path, connection: sqlite3.Connection, *, writable: bool = True) -> None:
        self.folder, self._writable = folder, writable
        self._connection = connection
        self._identity, self._kept = store_file.identity(self.path), ""
        self._guard = threading.RLock()
        self._objects: tuple[tuple[Any, ...], ListedObjects] | None = None
        self._decoded: dict[int, Decision] = {}  # a decision never changes, apart from being taken back

    @property
    def path(self) -> Path:
        """Path of the store."""
        return self.folder / NAME

    def add(self, correction: Correction, *, who: str) -> int:
        """Write a decision and return its identifier; it is on the disk when this returns."""
        return self.add_all([correction], who=who)[0]

    def add_all(self, corrections: list[Correction], *, who: str) -> list[int]:
        """Write decisions in one transaction, all or none; errors are those of `add`."""
        if not who.strip():
            raise ParameterError("the name of the user who corrects is empty: give one")
        made = datetime.now(UTC).isoformat(timespec="milliseconds")  # one time: the page takes them back together
        rows = [(made, *self._row(correction, who)) for correction in corrections]
        with self._transaction() as base:
            numbers = [int(base.execute(store_file.ADDED, row).lastrowid or 0) for row in rows]
            for number in numbers:
                store_file.sign(base, number)
        return numbers

    def _row(self, correction: Correction, who: str) -> tuple[Any, ...]:
        anchors: dict[str, dict[str, Any]] = {}
        for number in named_objects(correction):
            anchor = self.objects().anchor(number)
            if anchor is None:
                raise ParameterError(f"{self.folder}: the inventory has no object {number}")
            anchors[str(number)] = asdict(anchor)
        added = correction.payload.get("added") if correction.action == "note" else None
        if added is not None and added not in self.states().notes_of_added:
            raise ParameterError(f"{self.path}: no decision {added} in force has added an object")
        own = anchors.get(str(correction.object_id))
        check_values(correction, place=None if own is None else (own["x"], own["y"]))
        payload = json.dumps(dict(correction.payload), sort_keys=True, allow_nan=False)
        return who, correction.action, correction.object_id, correction.kind, payload, json.dumps(anchors)

    def undo(self, *identifiers: int, who: str = "") -> None:
        """Take decisions back in one transaction, all or none; they stay in the store, marked."""
        made = datetime.now(UTC).isoformat(timespec="milliseconds")
        with self._transaction() as base:
            for identifier in identifiers:
                change = "UPDATE decisions SET undone = ?, undone_by = ? WHERE id = ? AND undone = ''"
                if base.execute(change, (made, who, identifier)).rowcount != 1:
                    raise ParameterError(f"{self.path}: no decision {identifier!r} is in force")
                store_file.sign(base, identifier)

    def current(self) -> list[Decision]:
        """Return the decisions in force, in the order in which they were made."""
        return [decision for decision in self.history() if not decision.undone]

    def history(self) -> list[Decision]:
        """Return all decisions, also those that were undone."""
        with self._errors():
            marks = dict(self._connection.execute("SELECT id, undone FROM decisions ORDER BY id").fetchall())
            last = max(self._decoded, default=0)
            for row in self._connection.execute(f"{_READ} WHERE id > ?", (last,)).fetchall():
                self._decoded[row[0]] = _decision(row, self.path)
            for number, undone in marks.items():
                if self._decoded[number].undone != undone:
                    self._decoded[number] = replace(self._decoded[number], undone=undone)
            return [self._decoded[number] for number in marks]

    def mark(self) -> str:
        """Return a text that changes with every decision, also those of other processes."""
        with self._errors():
            query = "SELECT count(*), coalesce(sum(undone != ''), 0) FROM decisions"
            return "-".join(map(str, self._connection.execute(query).fetchone()))

    def object_states(self) -> dict[int, ObjectState]:
        """Return the state of each object of the present inventory that a decision in force is about."""
        return self.states().of_objects

    def states(self) -> Any:
        """Return `object_states`, the decisions that no longer match an object, and the painted points."""
        return fold_states(self.current(), self.objects())

    def objects(self) -> ListedObjects:
        """Return the objects of the present inventory; it is read again when its file changes."""
        with self._guard:
            mark = _mark(self.folder)
            if self._objects is None or self._objects[0] != mark:
                self._objects = mark, read_objects(self.folder)
            return self._objects[1]

    def close(self) -> None:
        """Close the store."""
        with self._guard:
            self._connection.close()

    def __enter__(self) -> CorrectionStore:
        """Return the store."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the store."""
        self.close()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        if not self._writable:
            raise _not_writable(self.path)
        with self._errors():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
                self._check_place()
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    @contextmanager
    def _errors(self) -> Iterator[None]:
        with self._guard, store_file.readable(self.path):
            self._check_place()
            yield

    def _check_place(self) -> None:
        """Raise ReadError if the file was replaced or deleted; its decisions are written to a new file."""
        if self._identity is None or store_file.identity(self.path) == self._identity:
            return
        if not self._kept:
            self._kept = store_file.rescued(self._connection, self.path).name
        raise ReadError(
            f"{self.path} was replaced or deleted while it was open: its decisions up to then are in {self._kept}; "
            "choose one of the files, and open the survey again"
        )


def open_corrections(folder: str | Path, *, write: bool = True, create: bool = True) -> CorrectionStore:
    """Open the corrections of an output folder; the store is created if there is none.

    Not to `write` reads a store that cannot be written from a copy in memory. Not to `create`, or a folder that cannot
    be written, gives a store without decisions that takes none.
    """
    place = Path(folder)
    if not place.is_dir():
        raise ReadError(f"{place}: no such folder: label the survey first (mlsroad label FILE)")
    path = place / NAME
    with store_file.readable(path):
        if not create and not os.path.lexists(path):
            return CorrectionStore(place, store_file.empty_in_memory(), writable=False)
        if os.access(place, os.W_OK) and (not path.exists() or os.access(path, os.W_OK)):
            return CorrectionStore(place, store_file.connected(path))
        if write:
            raise _not_writable(path)
        found = store_file.connected_to_copy(path) if os.path.lexists(path) else store_file.empty_in_memory()
        return CorrectionStore(place, found, writable=False)


def _not_writable(path: Path) -> ReadError:
    return ReadError(f"{path} cannot be written: change its permissions, or copy the folder")


def check_corrections(folder: str | Path) -> None:
    """Raise the errors of `open_corrections` for a folder that has a store."""
    if has_corrections(folder):
        open_corrections(folder, write=False).close()


def has_corrections(folder: str | Path) -> bool:
    """Return whether an output folder has a store."""
    return os.path.lexists(Path(folder, NAME))


def _decision(row: tuple[Any, ...], path: Path) -> Decision:
    identifier, *values, written = row
    if store_file.checksum(values) != written:
        raise ReadError(f"{path} is damaged: decision {identifier} has another checksum: restore it from a backup")
    made, who, action, object_id, kind, payload, anchors, undone, _ = values
    places: Mapping[str, Mapping[str, Any]] = json.loads(anchors)
    found = {int(number): Anchor(**value) for number, value in places.items()}
    return Decision(identifier, made, who, Correction(action, object_id, kind, json.loads(payload)), found, undone)


def _mark(folder: Path) -> tuple[Any, ...]:
    """Return what changes with the inventory of a folder: paths, sizes and times."""
    marks = []
    for name in INVENTORIES:
        path = folder / name
        if path.is_file():
            state = path.stat()
            marks.append((name, state.st_size, state.st_mtime_ns, state.st_ino))
    return tuple(marks)
