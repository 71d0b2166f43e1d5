"""Whether the database of runs and models can be used, told in one line before MLflow fails in many."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError

WAIT = 10.0
"""Seconds that a database may be held by another program before it counts as locked."""

_SQLITE = re.compile(r"sqlite:///(?!:memory:)(?P<path>.+)")
_ADVICE = {
    "locked": "another program holds it; wait for it or end it, or name another store in conf/local/mlflow.yml",
    "readonly": "it cannot be written; make it writable, or name another store in conf/local/mlflow.yml",
    "not a database": "it is damaged or another file; restore it, or move it away and train again",
}


class TrackingStoreError(MlsRoadError):
    """The database of runs and models cannot be used; the message names it and says what to do."""


def check_tracking_store(uri: str, *, wait: float = WAIT) -> None:
    """Raise an error where an SQLite store of MLflow is locked, read-only or no database; servers are not asked."""
    match = _SQLITE.fullmatch(uri)
    if match is None:
        return
    path = Path(match["path"])
    if not path.exists():
        return  # MLflow makes it
    try:
        with closing(sqlite3.connect(path, timeout=wait, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute("PRAGMA user_version").fetchone()
            connection.execute("ROLLBACK")
    except sqlite3.Error as error:
        advice = next((text for word, text in _ADVICE.items() if word in str(error)), "")
        raise TrackingStoreError(f"{path}: {error}" + (f": {advice}" if advice else "")) from error
