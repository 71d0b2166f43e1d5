"""What the parameters of all studies share: a scale chosen by name, and changes of a method's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

Scale = TypeVar("Scale")


def chosen_scale(kind: type[Scale], study: str, name: str, scales: Mapping[str, Any]) -> Scale:
    """Return a scale of a study by its name.

    Parameters
    ----------
    kind : type
        Dataclass of the scale; every field must be given.
    study : str
        Name of the study, for messages.
    name : str
        Name of the scale.
    scales : mapping of str to mapping
        Name to the fields.

    Returns
    -------
    dataclass
        The scale, checked.

    Raises
    ------
    ParameterError
        If there is none of that name, or a field is unknown or missing.
    """
    if name not in scales:
        raise ParameterError(f"{study}.scale {name!r} is unknown (scales: {', '.join(scales)})")
    given = dict(scales[name])
    known = {entry.name for entry in fields(kind)}  # type: ignore[arg-type]  # every kind of scale is a dataclass
    if set(given) != known:
        raise ParameterError(f"{study}.scales.{name} must have {sorted(known)}, got {sorted(given)}")
    return kind(**given)


def changed(parameters: Any, changes: Mapping[str, Any]) -> Any:
    """Change fields of a parameter dataclass, nested ones field by field.

    Parameters
    ----------
    parameters : dataclass
        The parameters.
    changes : mapping
        Field to its new value; a mapping changes fields of a nested dataclass.

    Returns
    -------
    dataclass
        The changed parameters.

    Raises
    ------
    ParameterError
        If there is no such field, or a value is outside its domain.

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
