"""What the parameters of all studies share: a scale chosen by name, and changes of a method's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

Scale = TypeVar("Scale")


def chosen_scale(kind: type[Scale], study: str, name: str, scales: Mapping[str, Any]) -> Scale:
    """Return a scale of a study by its name."""
    if name not in scales:
        raise ParameterError(f"{study}.scale {name!r} is unknown (scales: {', '.join(scales)})")
    given = dict(scales[name])
    known = {entry.name for entry in fields(kind)}  # type: ignore[arg-type]  # every kind of scale is a dataclass
    if set(given) != known:
        raise ParameterError(f"{study}.scales.{name} must have {sorted(known)}, got {sorted(given)}")
    return kind(**given)


def changed(parameters: Any, changes: Mapping[str, Any]) -> Any:
    """Change fields of a parameter dataclass, nested ones field by field.

    Examples
    --------
    >>> from mlsroad_pipeline.algorithms.patches.extraction import PatchParameters
    >>> changed(PatchParameters(), {"patch_size": 0.3}).patch_size
    0.3
    """
    known = {entry.name for entry in fields(parameters)}
    unknown = sorted(set(changes) - known)
    if unknown:
        raise ParameterError(f"{type(parameters).__name__} has no {', '.join(unknown)}")
    values = {}
    for name, value in changes.items():
        old = getattr(parameters, name)
        nested = is_dataclass(old) and isinstance(value, Mapping)
        values[name] = changed(old, value) if nested else value
    return replace(parameters, **values)
