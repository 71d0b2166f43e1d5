"""Fixtures shared by all tests."""

import io
import os

# Tests run side by side, a process per core: more threads of OpenMP in each take a fifth more time. Read at the first import of NumPy.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pickle
from pathlib import Path

import numpy as np
import pytest
from helpers.store import store_at
from omegaconf import OmegaConf

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("MLSROAD_DATA", REPOSITORY.parent / "shared" / "data"))
LONG = (
    "pipelines/test_bad_input.py",  # makes the run that the last five look at
    "pipelines/test_luo2019_study.py",
    "pipelines/test_slices.py",
    "execution/test_settings.py",
    "pipelines/test_luo2016_study.py",
    "pipelines/test_recognition_bad_input.py",
    "pipelines/test_tomic2019_study.py",
    "pipelines/test_yu2016_study.py",
    "test_notebooks.py",
    "pipelines/test_image_methods.py",
    "pipelines/test_label.py",
    "test_run.py",
    "pipelines/test_label_formats.py",
)
"""Files that take longest. They come first, so that at the end no process waits for another."""


@pytest.fixture(scope="session", autouse=True)
def _configuration_is_parsed_once():
    """Parse each text of a configuration once.

    Every run of Kedro reads fifty files, which takes longer than most of what the tests let it do.
    """
    parse, parsed = OmegaConf.load, {}

    def load(file):
        text = file.read() if hasattr(file, "read") else Path(file).read_text(encoding="utf-8")
        if text not in parsed:
            parsed[text] = pickle.dumps(parse(io.StringIO(text)))
        return pickle.loads(parsed[text])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OmegaConf, "load", staticmethod(load))
        yield


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


def pytest_collection_modifyitems(items):
    """Put the tests of long files first; within a file they keep their order."""
    place = {REPOSITORY / "tests" / name: k for k, name in enumerate(LONG)}
    if missing := [str(path) for path in place if not path.is_file()]:
        raise pytest.UsageError(f"tests/conftest.py orders files that are not there: {missing}")
    items.sort(key=lambda item: place.get(item.path, len(LONG)))


def pytest_terminal_summary(terminalreporter):
    """Say how many tests were skipped for want of real data."""
    skipped = [r for r in terminalreporter.stats.get("skipped", []) if "real data not found" in str(r.longrepr)]
    terminalreporter.write_line(f"skipped for want of real data: {len(skipped)}")


@pytest.fixture
def marks(tmp_path):
    folder = tmp_path / "marks"
    folder.mkdir()
    return folder


@pytest.fixture
def store(tmp_path):
    return store_at(tmp_path / "stage")
