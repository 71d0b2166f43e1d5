"""Fixtures of the tests of commands."""

import pytest


@pytest.fixture(scope="session")
def run(forked_commands):
    """Run `mlsroad` with arguments in a folder."""
    return lambda *arguments, cwd: forked_commands.run([*map(str, arguments)], cwd)
