"""Fixtures shared by all tests."""

import os
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("MLSROAD_DATA", REPOSITORY.parent / "shared" / "data"))


@pytest.fixture
def rng():
    """A seeded generator: the same numbers in every run."""
    return np.random.default_rng(20160217)


@pytest.fixture(scope="session")
def real_data():
    """Give the path of a public recording, or skip where it is not there."""

    def find(*parts: str) -> Path:
        path = DATA.joinpath(*parts)
        if not path.exists():
            pytest.skip(f"real data not found: {path} (set MLSROAD_DATA)")
        return path

    return find


def pytest_terminal_summary(terminalreporter):
    """Say how many tests were skipped for want of real data."""
    skipped = [r for r in terminalreporter.stats.get("skipped", []) if "real data not found" in str(r.longrepr)]
    terminalreporter.write_line(f"skipped for want of real data: {len(skipped)}")
