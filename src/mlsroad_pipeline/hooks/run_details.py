"""Details of a tracked run: name, flat parameters, commit, software environment and fingerprint of the input data."""

import dataclasses
import json
import os
import platform
import re
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from enum import Enum
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline
from pydantic import BaseModel

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import without_password
from mlsroad_pipeline.execution.digests import digest_file, new_digest

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


def typed_command(command: str, env: str | None, argv: Sequence[str] = ()) -> str:
    """Return the command as it was typed, else that of kedro-mlflow with the environment, without a deprecated option.

    kedro-mlflow leaves out `--config` and `--params`.
    """
    program = Path(argv[0] if argv else "")
    program = program.parent if program.name == "__main__.py" else program
    if program.name in ("kedro", "mlsroad", "mlsroad_pipeline"):
        return without_password(shlex.join([program.name, *argv[1:]]))
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


def fingerprint_files(paths: Sequence[str | Path]) -> dict[str, Any]:
    """Return path (below the common folder), size and digest of each file, totals, and one digest of all.

    Values are those of JSON; digests are BLAKE2b of 128 bits. Raises ReadError if a file cannot be read.
    """
    absolute = sorted({os.path.abspath(path) for path in paths})
    root = os.path.commonpath([os.path.dirname(path) for path in absolute]) if absolute else ""
    files = []
    for path in absolute:
        try:
            files.append((Path(path).relative_to(root).as_posix(), os.stat(path).st_size, digest_file(path)))
        except OSError as error:
            raise ReadError(f"{path}: cannot be fingerprinted: {error}") from error
    return {
        "digest": new_digest(json.dumps(files, ensure_ascii=False).encode("utf-8")).hexdigest(),
        **{"n_files": len(files), "bytes": sum(size for _, size, _ in files)},
        "files": [{"path": path, "bytes": size, "blake2b": digest} for path, size, digest in files],
    }


def source_files(tasks: Any) -> list[str]:
    """Return the paths of raw files among the inputs of scene tasks; other data have none."""
    paths: set[str] = set()
    if isinstance(tasks, Mapping):
        waiting = [task.inputs for task in tasks.values() if isinstance(getattr(task, "inputs", None), Mapping)]
        while waiting:
            value = waiting.pop()
            if isinstance(value, Mapping):
                waiting.extend(value.values())
            elif isinstance(value, list | tuple):
                waiting.extend(value)
            elif isinstance(getattr(value, "path", None), str):
                paths.add(value.path)
    return sorted(paths)


_ILLEGAL = re.compile(r"[^/\w.\- :]")
_FIELD = re.compile(r"^(Name|Version): *(.*?)\r?$", re.MULTILINE)


def is_parameter(name: str) -> bool:
    """Return whether a dataset is a parameter."""
    return name == "parameters" or name.startswith("params:")


def _children(value: Any) -> dict[str, Any] | None:
    """Return the named parts of a value, or None if it has none."""
    if isinstance(value, BaseModel):
        return {name: getattr(value, name) for name in type(value).model_fields}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(name): part for name, part in value.items()}
    if isinstance(value, list | tuple) and any(_children(part) is not None for part in value):
        return {str(k): part for k, part in enumerate(value)}
    return None


def flatten_parameters(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return all single parameters by dotted name.

    Examples
    --------
    >>> flatten_parameters({"forest": {"n_trees": 200, "classes": ["a", "b"]}, "seed": 1})
    {'forest.n_trees': '200', 'forest.classes': "['a', 'b']", 'seed': '1'}
    """
    flat: dict[str, str] = {}
    waiting = [(_ILLEGAL.sub("_", str(name)), value) for name, value in reversed(list(parameters.items()))]
    while waiting:
        name, value = waiting.pop()
        parts = _children(value)
        if parts:
            waiting.extend((f"{name}.{_ILLEGAL.sub('_', part)}", v) for part, v in reversed(list(parts.items())))
            continue
        unique, k = name, 2
        while unique in flat:
            unique, k = f"{name}_{k}", k + 1
        flat[unique] = "{}" if parts == {} and not isinstance(value, list | tuple) else _written(value)
    return flat


def pipeline_parameters(pipeline: Pipeline, catalog: CatalogProtocol) -> dict[str, str]:
    """Return the parameters that the nodes of a pipeline take, flat."""
    parameters: dict[str, Any] = {}
    taken = {name for node in pipeline.nodes for name in node.inputs if is_parameter(name)}
    for name in sorted(taken):
        value = catalog.load(name)
        parameters.update(value if name == "parameters" else {name.removeprefix("params:"): value})
    # `a` and `a.b`, inputs of two nodes, are one parameter
    inner = {name for name in parameters if any(name.startswith(f"{other}.") for other in parameters)}
    return flatten_parameters({name: value for name, value in parameters.items() if name not in inner})


MOST_PARAMETERS = 60
"""Largest number of parameters of a tracked run."""


def short_parameters(flat: Mapping[str, str], most: int = MOST_PARAMETERS) -> dict[str, str]:
    """Return parameters with the largest sections, the class schemes first, as one digest each until few are left.

    Examples
    --------
    >>> short_parameters({"a.x": "1", "b.x": "1", "b.y": "2"}, most=2)
    {'a.x': '1', 'b.digest': '245c9dbcf021'}
    """
    short = dict(flat)
    sections: dict[str, list[str]] = {}
    for name in flat:
        sections.setdefault(name.partition(".")[0], []).append(name)
    for section, names in sorted(sections.items(), key=lambda item: (item[0] != "classes", -len(item[1]), item[0])):
        if len(names) > 1 and (section == "classes" or len(short) > most):
            text = json.dumps({name: short.pop(name) for name in names}, ensure_ascii=False)
            short[f"{section}.digest"] = new_digest(text.encode("utf-8")).hexdigest()[:12]
    return short


def _written(value: Any) -> str:
    if isinstance(value, Enum):
        return str(value.value)
    if callable(value) and hasattr(value, "__qualname__"):
        # the default text of a function contains its address, which differs between runs
        return f"{value.__module__}.{value.__qualname__}"
    return str(value)


def git_state(folder: Path) -> dict[str, str]:
    """Return tags with the commit of the code and whether files differ from it; empty outside of a git repository."""
    outputs = []
    for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain"]):
        try:
            command = ["git", "-C", str(folder), *arguments]
            outputs.append(
                subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout.strip()
            )
        except (OSError, subprocess.SubprocessError):
            return {}
    return {"git.commit": outputs[0], "git.dirty": "true" if outputs[1] else "false"}


def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    """Return name and version of a distribution; parsing all of its metadata takes 50 times as long."""
    text = distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or ""
    head = dict(_FIELD.findall(text.partition("\n\n")[0]))
    return head.get("Name", ""), head.get("Version", "")


def environment() -> tuple[dict[str, str], list[str]]:
    """Return tags with the Python version and the platform of this process, and all packages as ``name==version``."""
    names = dict(map(_name_and_version, distributions()))
    packages = sorted((f"{name}=={version}" for name, version in names.items() if name), key=str.lower)
    return {"python": platform.python_version(), "platform": platform.platform()}, packages
