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

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError, ReadError
from mlsroad_pipeline.review.corrections.decisions import Anchor, Correction, Decision, named_objects
from mlsroad_pipeline.review.corrections.listed_objects import INVENTORIES, ListedObjects, read_objects
from mlsroad_pipeline.review.corrections.states import ObjectState, fold_states

NAME = "corrections.sqlite"
"""Name of the store in an output folder."""

APPLICATION, VERSION = 0x6D6C7263, 1
"""Identifier of the file ("mlrc") and version of its tables, in the header of SQLite."""

_WAIT = 5.0  # for another writer, seconds
_TABLES = """
CREATE TABLE decisions (
  id INTEGER PRIMARY KEY AUTOINCREMENT, made TEXT NOT NULL, who TEXT NOT NULL, action TEXT NOT NULL,
  object_id INTEGER, kind TEXT, payload TEXT NOT NULL, anchors TEXT NOT NULL,
  undone TEXT NOT NULL DEFAULT '', undone_by TEXT NOT NULL DEFAULT '');
"""
_READ = "SELECT id, made, who, action, object_id, kind, payload, anchors, undone FROM decisions"


class CorrectionsInUseError(MlsRoadError):
    """Another process keeps the store locked."""


class CorrectionStore:
    """Decisions about one output folder; safe for several threads and processes.

    Parameters
    ----------
    folder : Path
        The output folder.
    connection : sqlite3.Connection
        The open store.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self.folder = folder
        self._connection = connection
        self._guard = threading.RLock()
        self._objects: tuple[tuple[Any, ...], ListedObjects] | None = None
        self._decoded: dict[int, Decision] = {}  # a decision never changes, apart from being taken back

    @property
    def path(self) -> Path:
        """Path of the store."""
        return self.folder / NAME

    def add(self, correction: Correction, *, who: str) -> int:
        """Write a decision and return its identifier; it is on the disk when this returns.

        Parameters
        ----------
        correction : Correction
            The decision.
        who : str
            Name of the user.

        Returns
        -------
        int
            Its identifier.

        Raises
        ------
        ParameterError
            If the name is empty, or the inventory has no object of a named number.
        CorrectionsInUseError
            If another process keeps the store locked.
        ReadError
            If the store or the inventory is damaged.
        """
        return self.add_all([correction], who=who)[0]

    def add_all(self, corrections: list[Correction], *, who: str) -> list[int]:
        """Write decisions in one transaction, all or none; errors are those of `add`.

        Parameters
        ----------
        corrections : list of Correction
            The decisions.
        who : str
            Name of the user.

        Returns
        -------
        list of int
            Their identifiers.
        """
        if not who.strip():
            raise ParameterError("the name of the user who corrects is empty: give one")
        rows = [self._row(correction, who) for correction in corrections]
        with self._transaction() as base:
            return [
                int(
                    base.execute(
                        "INSERT INTO decisions (made, who, action, object_id, kind, payload, anchors)"
                        " VALUES (?, ?, ?, ?, ?, ?, ?)",
                        row,
                    ).lastrowid
                    or 0
                )
                for row in rows
            ]

    def _row(self, correction: Correction, who: str) -> tuple[Any, ...]:
        anchors: dict[str, dict[str, Any]] = {}
        for number in named_objects(correction):
            anchor = self.objects().anchor(number)
            if anchor is None:
                raise ParameterError(f"{self.folder}: the inventory has no object {number}")
            anchors[str(number)] = asdict(anchor)
        payload = json.dumps(dict(correction.payload), sort_keys=True, allow_nan=False)
        made = datetime.now(UTC).isoformat(timespec="milliseconds")
        return made, who, correction.action, correction.object_id, correction.kind, payload, json.dumps(anchors)

    def undo(self, identifier: int, *, who: str = "") -> None:
        """Take a decision back; it stays in the store, marked.

        Parameters
        ----------
        identifier : int
            Identifier of the decision.
        who : str
            Name of the user who takes it back.

        Raises
        ------
        ParameterError
            If there is no decision in force with this identifier.
        """
        made = datetime.now(UTC).isoformat(timespec="milliseconds")
        with self._transaction() as base:
            change = "UPDATE decisions SET undone = ?, undone_by = ? WHERE id = ? AND undone = ''"
            if base.execute(change, (made, who, identifier)).rowcount != 1:
                raise ParameterError(f"{self.path}: no decision {identifier!r} is in force")

    def current(self) -> list[Decision]:
        """Return the decisions in force, in the order in which they were made."""
        return [decision for decision in self.history() if not decision.undone]

    def history(self) -> list[Decision]:
        """Return all decisions, also those that were undone."""
        with self._errors():
            marks = dict(self._connection.execute("SELECT id, undone FROM decisions ORDER BY id").fetchall())
            last = max(self._decoded, default=0)
            for row in self._connection.execute(f"{_READ} WHERE id > ?", (last,)).fetchall():
                self._decoded[row[0]] = _decision(row)
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
        with self._errors():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    @contextmanager
    def _errors(self) -> Iterator[None]:
        with self._guard, _readable(self.path):
            yield


def open_corrections(folder: str | Path) -> CorrectionStore:
    """Open the corrections of an output folder; the store is created if there is none.

    Parameters
    ----------
    folder : str or Path
        Output folder of `label`.

    Returns
    -------
    CorrectionStore
        The open store.

    Raises
    ------
    ReadError
        If the folder is missing, or its ``corrections.sqlite`` is damaged or of another program or version.
    CorrectionsInUseError
        If another process keeps the store locked.
    """
    place = Path(folder)
    if not place.is_dir():
        raise ReadError(f"{place}: no such folder: label the survey first (mlsroad label FILE)")
    path = place / NAME
    with _readable(path):
        if not os.access(path if path.exists() else place, os.W_OK):
            raise ReadError(f"{path} cannot be written: change its permissions, or copy the folder")
        connection = sqlite3.connect(path, timeout=_WAIT, isolation_level=None, check_same_thread=False)
        try:
            _prepare(connection, path)
        except BaseException:
            connection.close()
            raise
    return CorrectionStore(place, connection)


def check_corrections(folder: str | Path) -> None:
    """Raise the errors of `open_corrections` for a folder that has a store.

    Parameters
    ----------
    folder : str or Path
        Output folder of `label`.
    """
    if has_corrections(folder):
        open_corrections(folder).close()


def has_corrections(folder: str | Path) -> bool:
    """Return whether an output folder has a store.

    Parameters
    ----------
    folder : str or Path
        Output folder of `label`.

    Returns
    -------
    bool
        Whether it has.
    """
    return Path(folder, NAME).is_file()


def _prepare(base: sqlite3.Connection, path: Path) -> None:
    base.execute("PRAGMA synchronous = FULL")
    found = [base.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")]
    if found == [0, 0] and not base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        base.execute("PRAGMA journal_mode = WAL")
        base.execute("BEGIN IMMEDIATE")
        if not base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:  # another process may have been first
            base.execute(_TABLES)
            base.execute(f"PRAGMA application_id = {APPLICATION}")
            base.execute(f"PRAGMA user_version = {VERSION}")
        base.execute("COMMIT")
        return
    if found[0] != APPLICATION:
        raise ReadError(f"{path} was not written by mlsroad: rename it")
    if found[1] != VERSION:
        raise ReadError(f"{path} has version {found[1]} of the corrections, this program reads {VERSION}: update it")
    base.execute(f"{_READ} LIMIT 1").fetchone()
    broken = base.execute("PRAGMA quick_check(1)").fetchone()[0]
    if broken != "ok":
        raise ReadError(f"{path} is damaged ({broken}): restore it from a backup")


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise the errors of SQLite as one line."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "locked" in str(error) or "busy" in str(error):
            raise CorrectionsInUseError(f"{path} is locked by another program: close it there") from error
        raise ReadError(f"{path} cannot be used: {error}") from error
    except (sqlite3.DatabaseError, json.JSONDecodeError, KeyError, TypeError) as error:
        raise ReadError(
            f"{path} is damaged or not a store of corrections ({error}): restore it from a backup"
        ) from error


def _decision(row: tuple[Any, ...]) -> Decision:
    identifier, made, who, action, object_id, kind, payload, anchors, undone = row
    values: Mapping[str, Mapping[str, Any]] = json.loads(anchors)
    found = {int(number): Anchor(**value) for number, value in values.items()}
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
