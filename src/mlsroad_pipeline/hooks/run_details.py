"""Details of a tracked run: flat parameters, commit of the code and software environment."""

from __future__ import annotations

import dataclasses
import platform
import re
import subprocess
from collections.abc import Mapping
from enum import Enum
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel

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


class Environment(NamedTuple):
    """Software environment: tags with the Python version and the platform, and all packages as ``name==version``."""

    tags: dict[str, str]
    packages: list[str]


def environment() -> Environment:
    """Return the environment of this process."""
    names = dict(map(_name_and_version, distributions()))
    packages = sorted((f"{name}=={version}" for name, version in names.items() if name), key=str.lower)
    return Environment({"python": platform.python_version(), "platform": platform.platform()}, packages)
