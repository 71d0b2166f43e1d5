"""A copy of the project in a folder of its own, runs of it, and the surveys that the tests of the wiring need."""

from __future__ import annotations

import contextlib
import functools
import getpass
import importlib.util
import inspect
import os
import pickle
import re
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any
from unittest import mock

import mlflow
import pytest
import yaml
from filelock import FileLock
from helpers.yaml_files import read_yaml
from kedro.framework.context import KedroContext
from kedro.framework.project import configure_project, pipelines
from kedro.framework.session import KedroSession
from kedro.io import core as kedro_core
from kedro.pipeline import Pipeline
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text
from mlflow.entities import Run
from omegaconf import _utils as omegaconf_utils
from omegaconf import base as omegaconf_base

from mlsroad_pipeline import pipeline_registry
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, oblique_view

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = "mlsroad_pipeline"
SURVEYS = {"train": {"preset": "tiny", "seed": 7}, "test": {"preset": "tiny", "seed": 11}}
TINY: dict[str, Any] = {
    **read_yaml(REPOSITORY / "conf/tiny.yml"),
    "execution": {"backend": "sequential"},
}
"""Parameters with which the whole comparison takes seconds."""


@functools.cache
def empty_store() -> bytes:
    """Return an MLflow store without a run, made once per version of MLflow; making one takes as long as ten tests."""
    path = Path(tempfile.gettempdir(), f"mlsroad_tests_{getpass.getuser()}", f"mlflow_{mlflow.__version__}.db")
    path.parent.mkdir(mode=0o700, exist_ok=True)
    if not path.exists():
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            made = Path(folder, "mlflow.db")
            mlflow.MlflowClient(tracking_uri=f"sqlite:///{made}").search_experiments()
            shutil.copy(made, Path(folder, "copy"))  # MLflow keeps the first one open
            Path(folder, "copy").replace(path)
    return path.read_bytes()


def make_project(folder: Path, *, tiny: bool = True) -> Path:
    """Copy configuration and layout of the project into a folder, with tiny surveys; the code stays where it is."""
    shutil.copytree(REPOSITORY / "conf", folder / "conf", dirs_exist_ok=True)
    if tiny:  # in place of the base's own: an environment could add surveys, but not take them away
        changed = folder / "conf/base/parameters_simulation.yml"
        simulation = {"enabled": True, "only": None, "surveys": SURVEYS}
        changed.write_text(yaml.safe_dump({"simulation": simulation}), encoding="utf-8")
        for name in ("methods", "studies"):
            catalog = folder / f"conf/base/catalog_{name}.yml"
            text, kind = catalog.read_text(encoding="utf-8"), ".FigureDataset\n"
            assert kind in text, catalog
            small = text.replace(kind, f"{kind}  dpi: 50\n")  # drawing larger ones takes a sixth of a run
            catalog.write_text(small, encoding="utf-8")
    shutil.copy(REPOSITORY / "pyproject.toml", folder)
    (folder / "mlflow.db").write_bytes(empty_store())
    (folder / ".telemetry").write_text("consent: false\n", encoding="utf-8")
    (folder / "src").mkdir(exist_ok=True)  # kedro asks for it; the package is imported from elsewhere
    (folder / "conf" / "local").mkdir(exist_ok=True)
    return folder


def joined(*trees: Mapping[str, Any]) -> dict[str, Any]:
    """Join nested parameters; later ones win."""
    result: dict[str, Any] = {}
    for tree in trees:
        for key, value in tree.items():
            old = result.get(key)
            both = isinstance(old, Mapping) and isinstance(value, Mapping)
            result[key] = joined(old, value) if both else value
    return result


@functools.cache
def _parsed(text: str, kind: type) -> bytes:
    return pickle.dumps(_parse(text, kind))


def _parsed_copy(text: str | IO[str], Loader: type) -> Any:
    """Return what `yaml.load` returns, and parse each text once."""
    return pickle.loads(_parsed(text if isinstance(text, str) else text.read(), Loader))


_parse = yaml.load
_parsed_reference = functools.cache(omegaconf_base.parse)
_register_pipelines = pipeline_registry.register_pipelines
_signature = functools.cache(inspect.signature)
_all_parameters = KedroContext._get_parameters


def _arguments(function: Callable[..., Any], /, *given: Any, **named: Any) -> dict[str, Any]:
    """Return what `inspect.getcallargs` returns, and read each signature once."""
    bound = _signature(function).bind(*given, **named)
    bound.apply_defaults()
    return bound.arguments


@functools.cache
def _registered(methods: tuple[str, ...], requested: tuple[str, ...] | None) -> dict[str, Pipeline]:
    return _register_pipelines()


def _pipelines_once() -> dict[str, Pipeline]:
    requested = pipelines._requested_pipelines
    return {**_registered(tuple(METHODS), None if requested is None else tuple(requested))}


def _parameters_of_run(context: KedroContext) -> dict[str, Any]:
    """Return the parameters without the nested ones that no node of the run takes, which are 2,000."""
    every, names = _all_parameters(context), context._pipelines_to_validate
    if names is None:
        return every
    taken = {name for pipeline in names for name in pipelines[pipeline].inputs()}
    return {name: value for name, value in every.items() if "." not in name or name in taken}


@functools.cache
def _configure_once() -> None:
    """Read the settings of the project, for which dynaconf inspects the source of all callers."""
    configure_project(PACKAGE)


@contextlib.contextmanager
def parsed_once() -> Iterator[None]:
    """Do what every session of Kedro repeats once per process; together it takes longer than most tests.

    That is to parse each text of a configuration and each reference in it, to make the pipelines, and to read the
    signatures of datasets, of which each parameter has one. MLflow looks for all installed packages before it loads a
    model, to compare them with those of the model. Kedro also tries to import ibis for each of them; where it
    is missing, Python looks through all folders.
    """
    if importlib.util.find_spec("ibis") is None:
        sys.modules["ibis"] = None  # type: ignore[assignment]  # the import fails at once
    try:
        with (
            mock.patch.object(yaml, "load", _parsed_copy),
            mock.patch.object(omegaconf_base, "parse", _parsed_reference),
            mock.patch.object(omegaconf_utils, "parse", _parsed_reference),
            mock.patch.object(kedro_core, "getcallargs", _arguments),
            mock.patch.object(KedroContext, "_get_parameters", _parameters_of_run),
            mock.patch.object(pipeline_registry, "register_pipelines", _pipelines_once),
            mock.patch.object(mlflow.pyfunc, "warn_dependency_requirement_mismatches", lambda *_: None),
        ):
            yield
    finally:
        if sys.modules.get("ibis", True) is None:
            del sys.modules["ibis"]


@contextlib.contextmanager
def small_figures() -> Iterator[None]:
    """Draw figures without text, without fitting them to it, and from small pictures of clouds.

    Together they take 40 % of a run of all methods.
    """
    with (
        mock.patch.object(Text, "draw", lambda *_: None),
        mock.patch.object(ConstrainedLayoutEngine, "execute", lambda *_: None),
        mock.patch.dict(birds_eye_view.__kwdefaults__, width=400),
        mock.patch.dict(oblique_view.__kwdefaults__, size=(400, 225)),
    ):
        yield


@contextlib.contextmanager
def session_of(project: Path, *, env: str | None = None, **parameters: Any) -> Iterator[KedroSession]:
    """Open a session in a project's folder, and leave MLflow afterwards as it was."""
    before = mlflow.get_tracking_uri()
    _configure_once()
    pipelines.configure(f"{PACKAGE}.pipeline_registry")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MLFLOW_")}
    try:
        with (
            mock.patch.dict(os.environ, environment, clear=True),  # MLflow copies the address in use to the environment
            parsed_once(),
            small_figures(),
            contextlib.chdir(project),
            KedroSession.create(project, env=env, runtime_params=parameters) as session,
        ):
            yield session
    finally:
        while mlflow.active_run() is not None:
            mlflow.end_run()
        mlflow.set_tracking_uri(before)


def run(
    project: Path,
    pipeline: str | None = None,
    *,
    env: str | None = None,
    to_nodes: Sequence[str] | None = None,
    **parameters: Any,
) -> dict[str, Any]:
    """Run a pipeline in a project's folder, as `kedro run` does, whole or up to nodes, named without namespaces."""
    with session_of(project, env=env, **parameters) as session:
        if to_nodes is not None:
            full = {node.name.rpartition(".")[2]: node.name for node in pipelines[pipeline or "__default__"].nodes}
            to_nodes = [full[name] for name in to_nodes]
        return session.run(pipeline_names=None if pipeline is None else [pipeline], to_nodes=to_nodes)


def tracked_runs(project: Path) -> dict[str, Run]:
    """Return the tracked runs of a project by the first word of their names: pipelines, and methods below them."""
    client = mlflow.MlflowClient(f"sqlite:///{project / 'mlflow.db'}")
    found = client.search_runs([experiment.experiment_id for experiment in client.search_experiments()])
    return {(run.info.run_name or "").split()[0]: run for run in found}


def shared_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run all methods, as `make run` does, on two tiny surveys, once for all tests and their processes; look, do not touch."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    folder = base / "shared_run"
    with FileLock(base / "shared_run.lock"):
        if not (folder / "done").exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make_project(folder)
            run(folder, "all_methods", **TINY)
            (folder / "done").touch()
    return folder


def with_models(shared: Path, folder: Path) -> Path:
    """Give a project of its own that knows the registered models of the shared run."""
    folder.mkdir(exist_ok=True)
    make_project(folder)
    shutil.copy(shared / "mlflow.db", folder)
    return folder


def copied_run(shared: Path, folder: Path) -> Path:
    """Copy the data of the shared run, and its store of runs; the registered models stay where they are."""
    unused = shutil.ignore_patterns("mlartifacts", "done")
    return Path(shutil.copytree(shared, folder, dirs_exist_ok=True, ignore=unused))


def copied_stages(shared: Path, folder: Path) -> Path:
    """Copy what the shared run has stored before any training: a run in the copy trains without simulating anew."""
    later = shutil.ignore_patterns("mlartifacts", "mlflow.db", "done", "06_models", "07_model_output", "08_reporting")
    shutil.copytree(shared, folder, dirs_exist_ok=True, ignore=later)
    (folder / "mlflow.db").write_bytes(empty_store())
    return folder


def label(project: Path, survey: Path | str, output: Path | str, **changes: Any) -> Path:
    """Label a survey as `kedro run --pipelines=label` does, with the forest of the shared run unless another is named.

    All candidates are listed: the forest of a tiny street gives low scores.
    """
    changes = {"method": "detrended_forest", "least_score": 0, **changes}
    own = {key: changes.pop(key) for key in ("ingest", "execution") if key in changes}
    parameters = {"label": {"survey": str(survey), "output": str(output), **changes}, **own}
    run(project, "label", **joined(TINY, parameters))
    return Path(output)


def contents(output: Path) -> dict[str, bytes]:
    """Give the results of `label` in a folder by name, without the state of the runs."""
    return {path.name: path.read_bytes() for path in sorted(output.glob("*")) if path.is_file()}


def stored_records(output: Path, stage: str) -> list[Path]:
    """Give the records of a stage in the states of all runs of an output."""
    return sorted(output.glob(f".mlsroad/*/{stage}/*/record.json"))


def stage_counts(messages: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Read from the log how many scenes each stage computed and how many it found valid."""
    pattern = re.compile(r"(\w+): \d+ scenes: (\d+) computed in [\d.]+ s, (\d+) already valid")
    found = [match for match in map(pattern.fullmatch, messages) if match]
    return {match[1]: (int(match[2]), int(match[3])) for match in found}


def last_line(error: BaseException) -> str:
    """Return what a user reads last when an error ends a command."""
    return "".join(traceback.format_exception_only(error)).strip().splitlines()[-1]
