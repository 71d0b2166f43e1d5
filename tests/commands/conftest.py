"""Fixtures of the tests of commands."""

import os

import pytest
from helpers.forking import forked_commands


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run `mlsroad` with arguments in a folder, outside of any tracked project."""
    place = tmp_path_factory.mktemp("printed")
    variables = {k: v for k, v in os.environ.items() if not k.startswith(("MLFLOW_", "KEDRO_", "COV_"))}
    with forked_commands(place, variables) as commands:
        yield lambda *arguments, cwd: commands.run([*map(str, arguments)], cwd)
