"""Run of a pipeline from the command `mlsroad`, inside a project or in any other folder.

Kedro's session loads every installed plugin, and with kedro-mlflow also MLflow: 2.0 s of processor time. This session
loads kedro-mlflow only where a run is tracked, and no other plugin.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

if TYPE_CHECKING:
    from kedro.framework.context import KedroContext
    from kedro.io import CatalogProtocol

PACKAGE = "mlsroad_pipeline"
STORE = "mlflow.db"
"""File below a project with its runs and models."""


class Place(NamedTuple):
    """Place that a command runs in: folder, configuration, whether it is a project, whether MLflow tracks the run."""

    folder: Path
    configuration: str
    is_project: bool
    tracked: bool


def find_place() -> Place:
    """Return the project that the working folder belongs to, or the working folder with the package's configuration."""
    tracked = bool(os.environ.get("MLFLOW_TRACKING_URI"))
    here = Path.cwd()
    for folder in (here, *here.parents):
        project = folder / "pyproject.toml"
        if project.is_file() and f'package_name = "{PACKAGE}"' in project.read_text(encoding="utf-8"):
            return Place(folder, str(folder / "conf"), True, tracked or (folder / STORE).is_file())
    return Place(here, str(files(PACKAGE) / "conf"), False, tracked)


KERNELS_OF_LABEL = 215
"""Kernels that a first `label` compiles."""


def compiled_kernels() -> int:
    """Return how many compiled kernels lie beside the package, or in the cache folder that Numba uses in its place."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    elsewhere = Path(os.environ.get("NUMBA_CACHE_DIR") or caches / "numba")
    found = sum(1 for _ in elsewhere.glob("*/*.nbi"))
    if os.environ.get("NUMBA_CACHE_DIR"):  # Numba uses no other then
        return found
    return found + sum(1 for _ in Path(str(files(PACKAGE))).rglob("__pycache__/*.nbi"))


def model_store(place: Place) -> Any:
    """Return the registered models of a place, or None where runs are not tracked."""
    if not place.tracked:
        return None
    from mlsroad_pipeline.label.model_choice import registered_models_at

    return registered_models_at(os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{place.folder / STORE}")


class Run(NamedTuple):
    """Catalog of a run, and the names of the nodes that ran."""

    catalog: CatalogProtocol
    nodes: frozenset[str]


def configure(place: Place) -> None:
    """Configure the logging and Kedro for the package; Kedro configures the logging when it is imported."""
    os.environ.setdefault("KEDRO_LOGGING_CONFIG", str(Path(place.configuration) / "logging.yml"))
    from kedro.framework.project import configure_project

    configure_project(PACKAGE)


def run_pipeline(name: str, parameters: Mapping[str, Any], *, place: Place) -> Run:
    """Run a pipeline with changed parameters, nested by section; `configure` comes first."""
    from kedro.framework.project import pipelines, settings
    from kedro.io.core import generate_timestamp
    from kedro.runner import SequentialRunner

    if "{" in str(place.folder) or "}" in str(place.folder):  # Kedro reads placeholders in them
        raise ParameterError(f"{place.folder} has a brace in its path: run the command in another folder")
    own = [hook for hook in settings.HOOKS if place.is_project or not getattr(hook, "writes_to_project", False)]
    hooks = _hook_manager([*own, *_tracking_hooks(place)])
    pipelines.set_requested([name])
    context = _context(name, parameters, place, hooks)
    hooks.hook.after_context_created(context=context)
    catalog, pipeline, run_id = context.catalog, pipelines[name], generate_timestamp()
    run_params = _run_params(name, parameters, place, run_id)
    hooks.hook.before_pipeline_run(run_params=run_params, pipeline=pipeline, catalog=catalog)
    try:
        result = SequentialRunner().run(pipeline, catalog, hooks, run_id=run_id)
    except BaseException as error:
        hooks.hook.on_pipeline_error(error=error, run_params=run_params, pipeline=pipeline, catalog=catalog)
        raise
    hooks.hook.after_pipeline_run(run_params=run_params, run_result=result, pipeline=pipeline, catalog=catalog)
    return Run(catalog, frozenset(node.name for node in pipeline.nodes))


def _context(name: str, parameters: Mapping[str, Any], place: Place, hooks: Any) -> KedroContext:
    """Return the context of a run, with the configuration of its place and the changed parameters."""
    from kedro.framework.context import KedroContext
    from kedro.framework.project import pipelines, settings

    class RunContext(KedroContext):
        """Context with the parameters that the pipeline takes and whole sections.

        Kedro's has every single value, which takes 0.6 s of processor time in place of 0.1 s.
        """

        def _get_parameters(self) -> dict[str, Any]:
            taken = pipelines[name].inputs()
            every = super()._get_parameters().items()
            return {key: value for key, value in every if "." not in key or key in taken}

    return RunContext(
        package_name=PACKAGE,
        project_path=place.folder,
        config_loader=settings.CONFIG_LOADER_CLASS(
            conf_source=place.configuration,
            env=None,
            runtime_params=dict(parameters),
            **settings.CONFIG_LOADER_ARGS,
        ),
        env=None,
        runtime_params=dict(parameters),  # type: ignore[arg-type]  # attrs derives the type from a generic converter
        hook_manager=hooks,
    )


def _run_params(name: str, parameters: Mapping[str, Any], place: Place, run_id: str) -> dict[str, Any]:
    """Return the facts of a run that Kedro gives to hooks; those that the commands do not set are None."""
    from kedro import __version__

    given: dict[str, Any] = {
        "run_id": run_id,
        "project_path": place.folder.as_posix(),
        "env": None,
        "kedro_version": __version__,
        "pipeline_names": [name],
        "runtime_params": dict(parameters),
        "runner": "SequentialRunner",
        "only_missing_outputs": False,
    }
    unset = ("tags", "from_nodes", "to_nodes", "node_names", "from_inputs", "to_outputs", "load_versions", "namespaces")
    return given | dict.fromkeys(unset)


def _tracking_hooks(place: Place) -> list[Any]:
    if not place.tracked:
        return []
    from kedro_mlflow.framework.hooks.mlflow_hook import mlflow_hook

    return [mlflow_hook]


def _hook_manager(hooks: list[Any]) -> Any:
    from kedro.framework.hooks import _create_hook_manager

    manager = _create_hook_manager()
    for hook in hooks:
        manager.register(hook)
    return manager
