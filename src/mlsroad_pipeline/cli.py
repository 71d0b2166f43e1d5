"""Kedro's command `run` with configuration files that are checked; Kedro loads a project's commands from this module.

`--config` takes a file with options of the command under `run`, or one with parameters alone.
"""

import copy
import functools
import os
import re
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click
from kedro.framework.cli.project import run as kedro_run
from kedro.framework.project import settings
from omegaconf import OmegaConf
from yaml import YAMLError

_KEDRO_PARAMS: Any = next(parameter.callback for parameter in kedro_run.params if parameter.name == "params")
_PATH = re.compile(r"(label|inspect|score|survey)\.(survey|output|trajectory|images|inventory|truth|root)")
_REFUSED = re.compile(r"Failed to instantiate \w+ for parameter '[^']*': (.+)\s*$")
_OPTIONS = [parameter.name for parameter in kedro_run.params if parameter.name and parameter.name != "config"]


def options_of(text: str) -> dict[str, Any]:
    """Return the options of `kedro run` that a configuration file describes.

    Examples
    --------
    >>> options_of("run: {pipelines: inspect}")
    {'pipelines': 'inspect'}
    >>> options_of("ingest: {scene_length: 15.0}")
    {'params': {'ingest': {'scene_length': 15.0}}}
    """
    try:
        content = OmegaConf.to_container(OmegaConf.create(text))
    except YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from error
    if not isinstance(content, dict) or None in content.values():
        raise ValueError("it holds neither options under `run:` nor sections of parameters")
    if "run" not in content:
        return {"params": content}
    options = content["run"]
    if not isinstance(options, dict):
        raise ValueError("`run:` holds no options such as `pipelines` and `params`")
    for name in options:
        if name not in _OPTIONS:
            near = get_close_matches(str(name), _OPTIONS, n=1) or _OPTIONS
            raise ValueError(f"unknown option run.{name}; did you mean {' or '.join(near)}?")
    return {str(name): value for name, value in options.items()}


def _read_options(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    """Make the options of a configuration file the defaults of the command."""
    if value:
        try:
            options = options_of(Path(value).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, ValueError) as error:
            raise click.BadParameter(f"{value}: {error}", context, parameter) from error
        context.default_map = {**(context.default_map or {}), **options}
    return value


def _read_parameters(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
    """Return the parameters as Kedro reads them, with paths as they were given; they replace those of `--config`."""
    read = _KEDRO_PARAMS(context, parameter, value)
    of_file = (context.default_map or {}).get("params")
    if isinstance(value, str) and of_file and value != of_file:
        read = OmegaConf.to_container(OmegaConf.merge(_KEDRO_PARAMS(context, parameter, of_file), read))
    for pair in value.split(",") if isinstance(value, str) else ():
        name, _, text = pair.partition("=")
        section, _, key = name.strip().partition(".")
        if _PATH.fullmatch(name.strip()) and isinstance(read[section][key], int | float):
            read[section][key] = text
    return read


def _check_environment(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    """Let the configuration loader refuse an unknown environment, before a session that logs a traceback."""
    source, env = context.params.get("conf_source") or settings.CONF_SOURCE, value or os.environ.get("KEDRO_ENV")
    settings.CONFIG_LOADER_CLASS(source, env=env, **settings.CONFIG_LOADER_ARGS)
    return value


def _cause(error: BaseException | None) -> str | None:
    """Return the message of the first error of this package in a chain, or of a refused parameter; None without one."""
    refused = _REFUSED.search(str(error))
    while error is not None and not type(error).__module__.startswith(f"{__package__}."):
        error = error.__cause__ or error.__context__
    return str(error) if error is not None else refused and refused[1]


def _with_one_line_errors(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command that ends with one line for an error of known cause; others keep their traceback."""

    @functools.wraps(command)
    def ended(*arguments: Any, **options: Any) -> Any:
        try:
            return command(*arguments, **options)
        except Exception as error:
            text = _cause(error)
            if text is None:
                raise
            raise click.ClickException(text) from error

    return ended


def _with_checked_config(command: click.Command) -> click.Command:
    """Return a copy of a command that reads `--config`, `--params` and `--env` by the functions above."""
    changed = copy.copy(command)
    if command.callback is not None:
        changed.callback = _with_one_line_errors(command.callback)
    changed.params = [copy.copy(parameter) for parameter in command.params]
    for parameter in changed.params:
        if parameter.name == "config":
            parameter.callback, parameter.is_eager = _read_options, True  # before the parameters that it is merged with
        if parameter.name == "params":
            parameter.callback = _read_parameters
        if parameter.name == "env":
            parameter.callback = _check_environment
    return changed


run = _with_checked_config(kedro_run)
"""`kedro run` of this project."""

cli = click.Group("mlsroad_pipeline", {"run": run})
"""Commands of this project, in place of Kedro's of the same name."""
