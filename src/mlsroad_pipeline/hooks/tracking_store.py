"""Check of the database of runs and models, with an error of one line before MLflow fails with many."""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError

WAIT = 10.0
"""Time to wait for another program that holds the database, seconds."""

_SQLITE = re.compile(r"sqlite:///(?!:memory:)(?P<path>.+)")
_ADVICE = {
    "locked": "another program holds it; wait for it or end it, or set another store in conf/local/mlflow.yml",
    "readonly": "it cannot be written; make it writable, or set another store in conf/local/mlflow.yml",
    "not a database": "it is damaged or of another type; restore it, or move it away and train again",
}


class TrackingStoreError(MlsRoadError):
    """Unusable database of runs and models; the message names it and a remedy."""


def check_tracking_store(uri: str, *, wait: float = WAIT) -> None:
    """Raise TrackingStoreError for an SQLite store that is locked, read-only or no database; skip servers."""
    match = _SQLITE.fullmatch(uri)
    if match is None:
        return
    path = Path(match["path"])
    if not path.exists():
        return  # MLflow creates it
    try:
        with closing(sqlite3.connect(path, timeout=wait, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute("PRAGMA user_version").fetchone()
            connection.execute("ROLLBACK")
    except sqlite3.Error as error:
        advice = next((text for word, text in _ADVICE.items() if word in str(error)), "")
        raise TrackingStoreError(f"{path}: {error}" + (f": {advice}" if advice else "")) from error
