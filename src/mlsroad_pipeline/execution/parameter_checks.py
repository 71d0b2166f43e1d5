"""Checks of parameters: known names, and paths, whose text on the command line stays text whatever YAML makes of it."""

import os
import re
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import printable

SETTINGS = ("default_pipeline", "execution", "stage_costs")
"""Sections that the base environment leaves to the globals, to other environments and to the command line."""

PLACES = ("label.survey", "label.output", "inspect.survey", "inspect.output")
"""Parameters that are files or folders."""

SCORED = ("score.inventory", "score.truth", "score.output")

PATHS = (
    *(*PLACES, "label.trajectory", "label.images", "label.sections", "label.keys_from", *SCORED),
    *("inspect.trajectory", "survey.root", "survey.trajectory"),
    *("image_labels.masks", "image_labels.weights", "image_labels.classes"),
)
"""Parameters that are paths or names of files; those that are no places may be null."""

_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
"""Start of an address such as ``s3://``; a letter and a colon alone are none, and ``./s3:/`` names a folder."""

_WITH_FILES = ("image_labels", "inspect", "label", "recognition", "recordings_study", "score", "shipped", "survey")
"""Sections with parameters that are files or folders."""

_NO_FILES = ("source", "crs", "read")
"""Names of parameters of these sections that may have an address in their text, or have free text below them."""


def local_path(value: str | os.PathLike[str], name: str) -> Path:
    """Return a file or folder of this machine, in place of which an address would become a folder named ``s3:``."""
    _check_utf8(os.fspath(value), name)
    if _ADDRESS.match(os.fspath(value)):
        raise ParameterError(
            f"{name} is {os.fspath(value)!r}, an address: this takes a file or folder; mount the store or copy the "
            "files. Scene stores and reports alone may lie at an address (docs/execution.md)"
        )
    return Path(value)


def with_text_of_paths(parameters: dict[str, Any], pairs: Iterable[str]) -> dict[str, Any]:
    """Return nested parameters in which paths that YAML took for numbers or dates have the text that was given.

    Examples
    --------
    >>> with_text_of_paths({"label": {"output": 461}}, ["label.output=0715"])
    {'label': {'output': '0715'}}
    """
    for pair in pairs:
        name, _, text = pair.partition("=")
        section, _, key = name.strip().partition(".")
        values = parameters.get(section)
        if name.strip() in PATHS and isinstance(values, dict) and isinstance(values.get(key), int | float):
            values[key] = text
    return parameters


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a nested mapping with changes at any depth; lists are replaced as a whole.

    Examples
    --------
    >>> merged({"label": {"scheme": "asprs", "files": [1, 2]}}, {"label": {"files": [3]}})
    {'label': {'scheme': 'asprs', 'files': [3]}}
    """
    both = {name for name in changes if isinstance(base.get(name), Mapping) and isinstance(changes[name], Mapping)}
    return {**base, **changes, **{name: merged(base[name], changes[name]) for name in both}}


def check_paths(parameters: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Check that paths are text and local."""
    for section, values in parameters.items():
        _check_texts(values, section, local_path if section in _WITH_FILES else _check_utf8)
    for name in PATHS:
        section, _, key = name.partition(".")
        values, own = parameters.get(section), given.get(section)
        value = values.get(key, "") if isinstance(values, Mapping) else ""
        for item in value if isinstance(value, list | tuple) else [value]:
            if isinstance(item, int | float):
                raise ParameterError(f"{name} is {item!r}, not text: write a name such as 0715 or 2024_05_01 in quotes")
        empty = section == "inspect" and isinstance(own, Mapping) and own.get(key) == ""  # `label` has its own message
        if name in PLACES and (value is None or empty):
            what = "null" if value is None else "empty"
            raise ParameterError(f"{name} is {what}: name a file or folder, or leave the parameter out")


def _check_texts(value: Any, name: str, check: Callable[[str, str], object]) -> None:
    """Check each text of a parameter and below it; texts of `_NO_FILES` need only be UTF-8."""
    if isinstance(value, str):
        check(value, name)
    elif isinstance(value, list | tuple):
        for item in value:
            _check_texts(item, name, check)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _check_texts(item, f"{name}.{key}", _check_utf8 if key in _NO_FILES else check)


def _check_utf8(value: str, name: str) -> None:
    """Raise ParameterError for a name of a file that is not UTF-8."""
    try:
        value.encode()
    except UnicodeEncodeError:
        raise ParameterError(f"{name} is '{printable(value)}', a name that is not UTF-8: rename it") from None


def check_names(given: Mapping[str, Any], base: Mapping[str, Any], source: str) -> None:
    """Check that sections and their keys are those of the base environment; others are misspelt.

    Examples
    --------
    >>> check_names({"labl": {"survey": "a.laz"}}, {"label": {"survey": ""}}, "--params")
    Traceback (most recent call last):
    ...
    mlsroad_pipeline.algorithms.core.exceptions.ParameterError: --params: unknown section labl; did you mean label?
    """
    for section, values in given.items():
        if section not in base and section not in SETTINGS:
            near = nearest_name(section, (*base, *SETTINGS))
            raise ParameterError(f"{source}: unknown section {section}; {near}")
        known = base.get(section)
        if isinstance(known, Mapping) and not isinstance(values, Mapping):
            raise ParameterError(f"{source}: {section} is a section, got {values!r}: set parameters below it")
        if isinstance(values, Mapping) and isinstance(known, Mapping):
            for key in values:
                if key not in known:
                    near = nearest_name(f"{section}.{key}", [f"{section}.{name}" for name in known])
                    raise ParameterError(f"{source}: unknown parameter {section}.{key}; {near}")


def nearest_name(name: str, known: Iterable[str]) -> str:
    """Return a question with the known name that is nearest to a misspelt one, or else all of them."""
    names = sorted(map(str, known))
    near = get_close_matches(name, names, n=1)
    return f"did you mean {near[0]}?" if near else f"known: {', '.join(names)}"
