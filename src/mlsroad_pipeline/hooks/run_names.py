"""Names of tracked runs: the pipeline, the survey and, for `label`, the model."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline

DEFAULT_NAME = "compare"
"""Name of the default pipeline."""


def _file_name(path: str) -> str:
    return Path(path.strip().rstrip("/")).name


def survey_name(pipeline: Pipeline, catalog: CatalogProtocol) -> str:
    """Return the name of the survey that a pipeline reads: its files for `label`, else the folder of the survey."""
    inputs = pipeline.inputs()
    if "params:label" in inputs:
        given = _field(catalog.load("params:label"), "survey") or ""
        first, *others = [given] if isinstance(given, str) else [*given] or [""]
        return _file_name(first) + (f" and {len(others)} more" if others else "")
    if "params:survey" in inputs:
        return _file_name(str(_field(catalog.load("params:survey"), "root") or ""))
    return ""


def run_name(run_params: Mapping[str, Any], pipeline: Pipeline, catalog: CatalogProtocol) -> str:
    """Return the name of a run, such as ``compare oakland`` or ``label street.laz``."""
    names = run_params.get("pipeline_names") or [run_params.get("pipeline_name") or "__default__"]
    default = "params:default_pipeline"
    named = (catalog.load(default) if default in catalog else None) or DEFAULT_NAME
    what = "+".join(str(named) if name == "__default__" else name for name in names)
    return f"{what} {survey_name(pipeline, catalog)}".strip()


def runner_name(runner: Any) -> str:
    """Return the class name of a runner; Kedro gives its default text, with a memory address, or None."""
    match = re.search(r"(\w+)(?: object at 0x\w+)?>?$", str(runner or None))
    return match[1] if match and match[1] != "None" else "SequentialRunner"


def typed_command(command: str, env: str | None) -> str:
    """Return a command of kedro-mlflow with the environment and without the deprecated option."""
    pipelines = command.replace("--pipeline=", "--pipelines=").replace(" --pipelines=__default__", "")
    return f"{pipelines} --env={env}" if env else pipelines


def is_registered(model: Mapping[str, Any]) -> bool:
    """Return whether the model in a summary of `label` is a registered one."""
    return model.get("source") == "registered"


def model_name(model: Mapping[str, Any]) -> str:
    """Return the name of the model in a summary of `label`, such as ``dense`` or ``detrended_forest version 3``."""
    name = str(model["name"]).removeprefix("mlsroad-")
    return f"{name} version {model['version']}" if is_registered(model) else name


def _field(parameters: Any, name: str) -> Any:
    return parameters.get(name) if isinstance(parameters, Mapping) else getattr(parameters, name, None)
