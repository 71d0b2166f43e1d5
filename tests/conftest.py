"""Fixtures shared by all tests."""

import functools
import gc
import inspect
import os
import re
from collections.abc import Callable, Container

# Tests run in one process per core; more OpenMP threads take 20 % more time. Read at the first import of NumPy.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# LightGBM's threads wait asleep. Where cores are shared, busy waiting takes thirty times the processor time.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from helpers import forking
from helpers.store import store_at

gc.disable()  # until all tests are collected: the imports leave little garbage, and collecting it takes a tenth of their time
REPOSITORY = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("MLSROAD_DATA", REPOSITORY.parent / "shared" / "data"))
LONG = (
    "pipelines/test_bad_input.py",  # makes the run that others use; the next four need none
    "pipelines/test_luo2019_study.py",
    "execution/test_backends.py",
    "commands/test_mlsroad.py",
    "commands/test_tutorial.py",
    "pipelines/test_tomic2019_study.py",
    "pipelines/test_label.py",
    "test_notebooks.py",
    "pipelines/test_own_images.py",
    "pipelines/test_image_methods.py",
    "pipelines/test_label_formats.py",
    "pipelines/test_label_runs.py",
    "pipelines/test_slices.py",
    "pipelines/test_luo2016_study.py",
    "test_documented_commands.py",
    "test_conf.py",
    "pipelines/test_recognition_bad_input.py",
    "simulation/test_truth.py",
    "surveys/test_simulated.py",
    "test_run.py",
    "pipelines/test_superpoint_transformer.py",
    "review/page_server/test_browser.py",
    "pipelines/test_recordings_study.py",
    "pipelines/test_yu2016_study.py",
    "pipelines/test_boosted_trees.py",
    "pipelines/test_add_a_method.py",
    "formats/test_fuzz.py",
    "formats/test_round_trips.py",
    "formats/test_recordings.py",
    "formats/test_las_damage.py",
    "formats/test_hostile.py",
    "surveys/test_fuzz_sides.py",
    "surveys/test_fuzz_images.py",
    "test_fuzz_corpus.py",
    "simulation/runtime/test_survey.py",
    "execution/test_faults.py",
)
"""Longest test files; they are slow, and run first, so that the processes end at about the same time."""

PROCESSES = re.compile(
    r"subprocess|Popen|LocalCluster|KernelManager|get_context|forkserver|loky|dask|wiring|tracked_project"
    r"|forked_commands|browser_page|served\(|Trials\("
)
TRAINING = re.compile(r"\b(train|fit|learn|continue)(ed)?(_\w+)?\(")
"""Patterns of test files that start processes, and of test files that train a model."""

MEMORY = Path("/dev/shm")
GIGABYTES = 8


def _has_room(folder: Path) -> bool:
    """Return whether a file system in memory has room for the folders of the tests."""
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        return False
    return min(psutil.disk_usage(str(folder)).free, psutil.virtual_memory().available) >= GIGABYTES * 2**30


# Every stage and every tracked run waits for the disk many times, which is a quarter of the time of the suite.
if _has_room(MEMORY):
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))


@pytest.fixture
def rng():
    """Random generator with a fixed seed."""
    return np.random.default_rng(20160217)


@pytest.fixture(scope="session")
def real_data():
    """Return a function that returns the path of a public recording, or skips the test if it is missing."""

    def find(*parts: str) -> Path:
        path = DATA.joinpath(*parts)
        if not path.exists():
            pytest.skip(f"real data not found: {path} (set MLSROAD_DATA)")
        return path

    return find


@pytest.fixture(scope="session")
def forked_commands(tmp_path_factory):
    """Return the process that forks one process per command of `mlsroad`."""
    with forking.serving(tmp_path_factory.mktemp("printed")) as commands:
        yield commands


def _marks_of(path: Path, long: Container[Path]) -> list[str]:
    """Return the marks of the tests of a file: of long files, and by what their source contains."""
    source = path.read_text(encoding="utf-8")
    found = {"slow": path in long, "process": PROCESSES.search(source), "training": TRAINING.search(source)}
    return [mark for mark, is_found in found.items() if is_found]


@functools.cache
def _file_of(function: Callable[..., Any]) -> Path | None:
    """Return the file of a fixture, None for those of plugins."""
    path = Path(inspect.unwrap(function).__code__.co_filename)
    return path if path.is_relative_to(REPOSITORY / "tests") else None


def _files_of(item: pytest.Function) -> set[Path]:
    """Return the file of a test and those of its fixtures, which may start a process in its place."""
    known = item._fixtureinfo.name2fixturedefs.values()
    return {item.path} | ({_file_of(fixture.func) for fixtures in known for fixture in fixtures} - {None})


def pytest_collection_modifyitems(items):
    """Add marks, and run long files first; tests of a file keep their order."""
    place = {REPOSITORY / "tests" / name: k for k, name in enumerate(LONG)}
    if missing := [str(path) for path in place if not path.is_file()]:
        raise pytest.UsageError(f"LONG in tests/conftest.py names missing files: {missing}")
    marks: dict[Path, list[str]] = {Path(__file__): []}
    marks_of_test: dict[int, set[str]] = {}  # by the fixtures, which all parameters of a test share
    for item in items:
        test = id(item._fixtureinfo)
        if test not in marks_of_test:
            files = _files_of(item)
            for path in files - marks.keys():
                marks[path] = _marks_of(path, place)
            marks_of_test[test] = {mark for path in files for mark in marks[path]}
        for mark in marks_of_test[test]:
            item.add_marker(mark)
    items.sort(key=lambda item: place.get(item.path, len(LONG)))


def pytest_collection_finish():
    """Leave the modules and tests out of garbage collection, and collect less often: it takes a tenth of most runs."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)
    gc.enable()


def pytest_terminal_summary(terminalreporter):
    """Print the number of tests skipped for lack of real data."""
    skipped = [r for r in terminalreporter.stats.get("skipped", []) if "real data not found" in str(r.longrepr)]
    terminalreporter.write_line(f"skipped for lack of real data: {len(skipped)}")


@pytest.fixture
def marks(tmp_path):
    folder = tmp_path / "marks"
    folder.mkdir()
    return folder


@pytest.fixture
def store(tmp_path):
    return store_at(tmp_path / "stage")
