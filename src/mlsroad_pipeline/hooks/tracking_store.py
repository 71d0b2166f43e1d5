"""Address and check of the database of runs and models, with an error of one line before MLflow fails with many."""

from __future__ import annotations

import os
import re
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, without_password

WAIT = 10.0
"""Time to wait for another program that holds the database, seconds."""

TRACKING_URI, REGISTRY_URI = "MLFLOW_TRACKING_URI", "MLFLOW_REGISTRY_URI"
"""Environment variables of MLflow."""

_RELATIVE = re.compile(r"sqlite:///(?!/)(?!:memory:)(?P<path>.+)")
_SQLITE = re.compile(r"sqlite:///(?!:memory:)(?P<path>.+)")
_ADVICE = {
    "locked": "another program holds it; wait for it or end it, or set another store in conf/local/mlflow.yml",
    "readonly": "it cannot be written; make it writable, or set another store in conf/local/mlflow.yml",
    "not a database": "it is damaged or of another type; restore it, or move it away and train again",
}


class TrackingStoreError(MlsRoadError):
    """Unusable database of runs and models; the message names it and a remedy."""


_configured: dict[str, str] = {}
"""Variable to the address that a configuration gave last; MLflow copies the address in use to the environment."""


def resolve_store(config: Mapping[str, Any], project: Path) -> dict[str, Any]:
    """Return the content of `mlflow.yml` with the addresses in use.

    An environment variable replaces the configured address. A relative SQLite file of the configuration lies below the
    project folder, one of an environment variable below the working directory, as everywhere in MLflow.
    """
    server = dict(config.get("server") or {})
    resolved = {**config, "server": server}
    for key, variable in (("mlflow_tracking_uri", TRACKING_URI), ("mlflow_registry_uri", REGISTRY_URI)):
        given = os.environ.get(variable) or ""
        if given and given != _configured.get(variable):
            server[key] = _absolute(given, Path.cwd())
            if key == "mlflow_tracking_uri":
                resolved["tracking"] = _with_artifacts_of(server[key], config.get("tracking") or {})
            continue
        if server.get(key):
            server[key] = _absolute(server[key], project.resolve())
        _configured[variable] = server.get(key) or ""
    return resolved


def _with_artifacts_of(uri: str, tracking: Mapping[str, Any]) -> dict[str, Any]:
    """Return the section `tracking` with artifacts beside an SQLite store; a server has a place of its own."""
    experiment = dict(tracking.get("experiment") or {})
    match = _SQLITE.fullmatch(uri)
    place = (Path(match["path"]).parent / "mlartifacts").as_uri() if match else None
    arguments = {**(experiment.get("create_experiment_kwargs") or {}), "artifact_location": place}
    return {**tracking, "experiment": {**experiment, "create_experiment_kwargs": arguments}}


def _absolute(uri: str, folder: Path) -> str:
    match = _RELATIVE.fullmatch(uri)
    return f"sqlite:///{folder / match['path']}" if match else uri


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


def is_of_store(error: BaseException) -> bool:
    """Return whether an error comes from MLflow or its database."""
    return isinstance(error, sqlite3.Error) or type(error).__module__.split(".")[0] in (
        "mlflow",
        "sqlalchemy",
        "requests",
    )


def store_failure(error: BaseException) -> str:
    """Return what is wrong with the store in one line, without a password."""
    import mlflow  # noqa: PLC0415  # a run is tracked: it is loaded

    text = without_password(printable(error).partition(" [SQL:")[0])
    return f"the store of MLflow {without_password(mlflow.get_tracking_uri())} failed: {text[:300]}"
