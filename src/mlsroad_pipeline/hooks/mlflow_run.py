"""Hooks of a tracked run, in addition to those of kedro-mlflow, and the check of its database of runs and models.

This module imports MLflow only where a run is tracked: `mlsroad` also runs pipelines without kedro-mlflow.
"""

from __future__ import annotations

import http.client
import logging
import os
import re
import sqlite3
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
from kedro.config import MissingConfigException
from kedro.framework.context import KedroContext
from kedro.framework.hooks import hook_impl
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened, without_password
from mlsroad_pipeline.hooks.run_details import is_parameter

if TYPE_CHECKING:
    from mlsroad_pipeline.hooks.run_records import RunRecords

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
    """Raise TrackingStoreError for an SQLite store that is locked, read-only or no database, or a server out of reach.

    MLflow itself would try for more than six minutes to reach the server.
    """
    if uri.startswith(("http://", "https://")):
        _check_server(uri, wait)
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


def _check_server(uri: str, wait: float) -> None:
    """Raise TrackingStoreError for a server that does not answer; any answer will do, also a refusal."""
    try:
        with urllib.request.urlopen(
            urllib.request.Request(f"{uri.rstrip('/')}/health"), timeout=wait
        ):  # an address of the user
            return
    except urllib.error.HTTPError:
        return
    except (OSError, ValueError, http.client.HTTPException) as error:
        source = f"{TRACKING_URI} or conf/base/mlflow.yml"
        reason = getattr(error, "reason", None) or error
        raise TrackingStoreError(
            f"the MLflow server {without_password(uri)} does not answer ({reason}): start it, or change {source}"
        ) from error


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
    return f"the store of MLflow {without_password(mlflow.get_tracking_uri())} failed: {shortened(text, 300)}"


logger = logging.getLogger(__name__)

VARIABLES = {
    "MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING": "true",  # processor, memory, disk and network of a run
    "MLFLOW_SYSTEM_METRICS_SAMPLING_INTERVAL": "5",  # s; MLflow's default of 10 s leaves short runs without any
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",  # it would draw bars for files of a few kB
}
"""Environment variables of MLflow; those that the user has set are kept."""


class MlflowDetailsHooks:
    """Add parameters, scores, figures, the fingerprint of the data, the commit and the environment to a run.

    Without tracking, nothing is recorded. A store that fails during a run ends the recording, not the run: results are
    written all the same, and an error at the end names the store.
    """

    def __init__(self) -> None:
        self._records: RunRecords | None = None
        self._failure: str | None = None

    @hook_impl(tryfirst=True)
    def after_context_created(self, context: KedroContext) -> None:
        """Set the store of the environment variables or of the configuration, and check it."""
        loader = context.config_loader
        if "mlflow" not in getattr(loader, "config_patterns", {}):
            return
        try:
            config = dict(loader["mlflow"])
        except MissingConfigException:
            return
        loader["mlflow"] = resolve_store(config, Path(context.project_path))
        check_tracking_store(loader["mlflow"]["server"].get("mlflow_tracking_uri") or "")
        for variable, value in VARIABLES.items():
            os.environ.setdefault(variable, value)
        psutil.cpu_percent()  # its first value, which MLflow would record for a short run, is always zero

    @hook_impl(trylast=True)
    def before_pipeline_run(self, run_params: dict[str, Any], pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        """Take the run that kedro-mlflow has opened, and record parameters, code and environment."""
        self._records, self._failure = None, None
        run = sys.modules["mlflow"].active_run() if "mlflow" in sys.modules else None
        if run is None:
            return
        from mlsroad_pipeline.hooks.interrupted_runs import at_exit, close_stale_runs  # noqa: PLC0415  # imports MLflow
        from mlsroad_pipeline.hooks.run_records import RunRecords  # noqa: PLC0415  # imports MLflow

        at_exit(self._end_killed)

        def begin() -> None:
            close_stale_runs(run.info.experiment_id)
            self._records = RunRecords(run, run_params, pipeline, catalog)

        self._guarded(begin)

    def _guarded(self, action: Callable[[], None]) -> None:
        """Call a function that records something; the first error ends the recording."""
        try:
            action()
        except Exception as error:  # of SQLite, of a server, of a full disk
            self._records = None
            self._failure = store_failure(error)
            logger.error("%s; nothing more of this run is recorded, its results are written", self._failure)

    @hook_impl(tryfirst=True)
    def before_node_run(self, inputs: dict[str, Any]) -> None:
        """Remove parameters, which kedro-mlflow would record again per node, with dataclasses as one string."""
        if self._records is not None:
            for name in [name for name in inputs if is_parameter(name)]:
                del inputs[name]

    @hook_impl
    def before_dataset_saved(self, dataset_name: str) -> None:
        """Open the run of a method before its model is registered."""
        if (records := self._records) is not None:
            self._guarded(lambda: records.before_saving(dataset_name))

    @hook_impl
    def after_dataset_saved(self, dataset_name: str, data: Any) -> None:
        """Record scores and series as metrics, figures, reports and inventories as artifacts; collect raw files."""
        if (records := self._records) is not None:
            self._guarded(lambda: records.add(dataset_name, data))

    @hook_impl(wrapper=True)
    def after_pipeline_run(self) -> Generator[None, Any, Any]:
        """Record the raw files of the run, end the runs of the methods, and raise TrackingStoreError if that failed."""
        self._end("FINISHED")
        try:
            result = yield
        except Exception as error:
            if self._failure is None and not is_of_store(error):
                raise
            raise TrackingStoreError(self._described(store_failure(error))) from error
        if self._failure is not None:
            raise TrackingStoreError(self._described(self._failure))
        return result

    def _described(self, failure: str) -> str:
        return f"{self._failure or failure}; the results are written, but this run is not recorded whole in MLflow"

    @hook_impl(tryfirst=True)
    def on_pipeline_error(self) -> None:
        """End the runs of the methods."""
        self._end("FAILED")

    def _end_killed(self) -> None:
        """End a run that neither finished nor failed: it was interrupted."""
        if self._records is not None:
            self._end("KILLED")
            sys.modules["mlflow"].end_run("KILLED")

    def _end(self, status: str) -> None:
        records, self._records = self._records, None
        if records is not None:
            self._guarded(lambda: records.finish(status))
