"""Files of the configuration, and the parameters and catalog of an environment."""

import functools

import click
from helpers.wiring import REPOSITORY, session_of
from helpers.yaml_files import read_yaml

from mlsroad_pipeline.cli import run

CONF = REPOSITORY / "conf"


def base_groups():
    """Return the groups of parameters of the base environment; a variant of a method is in the file of the method."""
    return {name: group for path in (CONF / "base").glob("parameters_*.yml") for name, group in read_yaml(path).items()}


def base(group):
    return base_groups()[group]


def context_of(project, env, **parameters):
    with session_of(project, env=None if env == "base" else env, **parameters) as session:
        return session.load_context()


def parameters_of(project, env="base", **parameters):
    return context_of(project, env, **parameters).params


@functools.cache
def configured(project, env):
    """Return the catalog and the parameters of an environment as it stands; look, do not touch."""
    context = context_of(project, env)
    return context.catalog, context.params


def from_command_line(text):
    """Nest what `--params=` takes as `kedro run` of this project does."""
    parameter = next(option for option in run.params if option.name == "params")
    return parameter.process_value(click.Context(run), text)
