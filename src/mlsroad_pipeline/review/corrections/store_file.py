"""SQLite file of a store of corrections: creation, checks of a file that exists, rescue of one that was replaced."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import sqlite3
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable

APPLICATION, VERSION = 0x6D6C7263, 2
"""Identifier of the file ("mlrc") and version of its tables, in the header of SQLite."""

WAIT = 5.0
"""Longest wait for another writer, seconds."""

ADDED = "INSERT INTO decisions (made, who, action, object_id, kind, payload, anchors) VALUES (?, ?, ?, ?, ?, ?, ?)"
FIELDS = "made, who, action, object_id, kind, payload, anchors, undone, undone_by"
"""Columns that the checksum of a decision covers."""

_FIRST_TABLE = """
CREATE TABLE decisions (
  id INTEGER PRIMARY KEY AUTOINCREMENT, made TEXT NOT NULL, who TEXT NOT NULL, action TEXT NOT NULL,
  object_id INTEGER, kind TEXT, payload TEXT NOT NULL, anchors TEXT NOT NULL,
  undone TEXT NOT NULL DEFAULT '', undone_by TEXT NOT NULL DEFAULT '')
"""
_CHECKSUM = "checksum TEXT NOT NULL DEFAULT ''"
TABLES = {1: _FIRST_TABLE, 2: f"{_FIRST_TABLE.rstrip()[:-1]}, {_CHECKSUM})"}


class CorrectionsInUseError(MlsRoadError):
    """Another process keeps the store locked."""


def checksum(values: Sequence[Any]) -> str:
    """Return the checksum of the values of `FIELDS` of a decision."""
    return hashlib.blake2b(json.dumps(list(values)).encode(), digest_size=8).hexdigest()


def connected(path: Path) -> sqlite3.Connection:
    """Open a store for reading and writing; it is created if there is none."""
    if not os.path.lexists(path):
        _create(path)
    _check_files(path)
    connection = _open(path)
    try:
        _check(connection, path)
        connection.execute("PRAGMA synchronous = FULL")
        _upgrade(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def connected_to_copy(path: Path) -> sqlite3.Connection:
    """Open a copy in memory of a store that cannot be written, with what its write-ahead log holds."""
    _check_files(path)
    with tempfile.TemporaryDirectory() as folder:
        for name in (path.name, f"{path.name}-wal"):
            if (path.parent / name).exists():
                shutil.copyfile(path.parent / name, Path(folder, name))
        with closing(connected(Path(folder, path.name))) as copy:
            memory = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
            copy.backup(memory)
    memory.execute("PRAGMA query_only = ON")
    return memory


def empty_in_memory() -> sqlite3.Connection:
    """Open a store without decisions in memory, of a folder that cannot be written."""
    memory = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    memory.execute(TABLES[VERSION])
    memory.execute("PRAGMA query_only = ON")
    return memory


def _open(path: Path) -> sqlite3.Connection:
    address = f"{path.absolute().as_uri()}?mode=rw"  # never creates a file
    connection = sqlite3.connect(address, uri=True, timeout=WAIT, isolation_level=None, check_same_thread=False)
    connection.execute("PRAGMA trusted_schema = OFF")
    return connection


def _create(path: Path) -> None:
    """Create an empty store under another name, so that none is ever half written, and give it its name."""
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as folder:
        new = Path(folder, path.name)
        with closing(sqlite3.connect(new, isolation_level=None)) as base:
            base.execute("PRAGMA synchronous = FULL")
            base.execute(TABLES[VERSION])
            base.execute(f"PRAGMA application_id = {APPLICATION}")
            base.execute(f"PRAGMA user_version = {VERSION}")
            base.execute("PRAGMA journal_mode = WAL")
        with closing(sqlite3.connect(new, isolation_level=None)) as base:
            _check(base, path)  # SQLite ignores errors of the write-ahead log while it closes a file
        if len(os.listdir(folder)) > 1:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        try:
            os.link(new, path)
        except FileExistsError:  # another process was first
            return
        except OSError:  # a file system without hard links
            if not os.path.lexists(path):
                new.rename(path)


def _check_files(path: Path) -> None:
    """Raise ReadError for links and what is not a file, which SQLite would follow, and for an empty file."""
    for file in (path, *(path.with_name(path.name + end) for end in ("-wal", "-shm", "-journal"))):
        if os.path.lexists(file) and not stat.S_ISREG(file.lstat().st_mode):
            raise ReadError(f"{file} is a link, or not a file: put the store itself in its place")
    if not path.stat().st_size:
        raise ReadError(f"{path} is empty (0 bytes): restore it from a backup, or delete it to start without decisions")


def _check(base: sqlite3.Connection, path: Path) -> None:
    """Raise ReadError unless the tables are exactly those of a version of the store, and whole."""
    application, version = (base.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version"))
    if application != APPLICATION:
        raise ReadError(f"{path} was not written by mlsroad: rename it")
    if version not in TABLES:
        raise ReadError(f"{path} has version {version} of the corrections, this program reads {VERSION}: update it")
    found = base.execute("SELECT type, name, sql FROM sqlite_master WHERE name != 'sqlite_sequence'").fetchall()
    others = [f"{kind} {name}" for kind, name, _ in found if (kind, name) != ("table", "decisions")]
    if others:
        raise ReadError(f"{path} has {printable(others[0])}, which no store of mlsroad has: restore it from a backup")
    if [_plain(sql) for _, _, sql in found] != [_plain(TABLES[version])]:
        raise ReadError(f"{path} has other columns than a store of mlsroad: restore it from a backup")
    broken = base.execute("PRAGMA quick_check(1)").fetchone()[0]
    if broken != "ok":
        raise ReadError(f"{path} is damaged ({printable(broken)}): restore it from a backup")


def _plain(sql: str) -> str:
    return re.sub(r"\s", "", sql)


def _upgrade(base: sqlite3.Connection) -> None:
    """Add the checksums to a store of version 1."""
    if base.execute("PRAGMA user_version").fetchone()[0] == VERSION:
        return
    base.execute("BEGIN IMMEDIATE")
    try:
        if base.execute("PRAGMA user_version").fetchone()[0] != VERSION:  # another process may have been first
            base.execute(f"ALTER TABLE decisions ADD COLUMN {_CHECKSUM}")
            for number in [row[0] for row in base.execute("SELECT id FROM decisions").fetchall()]:
                sign(base, number)
            base.execute(f"PRAGMA user_version = {VERSION}")
        base.execute("COMMIT")
    except BaseException:
        if base.in_transaction:
            base.execute("ROLLBACK")
        raise


def sign(base: sqlite3.Connection, number: int) -> None:
    """Write the checksum of a decision."""
    values = base.execute(f"SELECT {FIELDS} FROM decisions WHERE id = ?", (number,)).fetchone()
    base.execute("UPDATE decisions SET checksum = ? WHERE id = ?", (checksum(values), number))


def identity(path: Path) -> tuple[int, int] | None:
    """Return device and inode of a store, None where there is no file."""
    try:
        state = path.lstat()
    except FileNotFoundError:
        return None
    return state.st_dev, state.st_ino


def rescued(connection: sqlite3.Connection, path: Path) -> Path:
    """Write the decisions of an open store whose file is gone into a new file beside it, and return its path."""
    time = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    for number in range(100):
        target = path.with_name(f"{path.stem}-kept-{time}{f'-{number}' if number else ''}{path.suffix}")
        if not os.path.lexists(target):
            break
    with closing(sqlite3.connect(target)) as new:
        connection.backup(new)
    return target


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raise the errors of SQLite as one line."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "locked" in str(error) or "busy" in str(error):
            raise CorrectionsInUseError(f"{path} is locked by another program: close it there") from error
        if "decode" not in str(error):  # text that is not UTF-8
            raise ReadError(f"{path} cannot be used: {printable(error)}") from error
        raise _damaged(path, error) from error
    except MlsRoadError:
        raise
    except (sqlite3.DatabaseError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> ReadError:
    return ReadError(f"{path} is damaged or not a store of corrections ({printable(error)}): restore it from a backup")
