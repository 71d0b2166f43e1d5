"""Fixtures shared by all tests."""

import gc
import inspect
import os
import re
import sys
from collections.abc import Container

# Tests run in one process per core; more OpenMP threads take 20 % more time. Read at the first import of NumPy.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from pathlib import Path
from types import CodeType

import numpy as np
import psutil
import pytest
from helpers.store import store_at

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("MLSROAD_DATA", REPOSITORY.parent / "shared" / "data"))
LONG = (
    "pipelines/test_bad_input.py",  # makes the run that others use; the next four need none
    "pipelines/test_luo2019_study.py",
    "execution/test_backends.py",
    "commands/test_mlsroad.py",
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
    "simulation/runtime/test_survey.py",
    "execution/test_faults.py",
)
"""Longest test files; they are slow, and run first, so that the processes end at about the same time."""

PROCESSES = re.compile(r"subprocess|Popen|LocalCluster|KernelManager|get_context|forkserver|loky|dask")
TRAINING = re.compile(r"(?!trained_methods)(train|fit|learn|continue)(ed)?(_\w+)?")
"""Names and constants of tests that start processes, and of those that train a model."""

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


def _words(code: CodeType) -> set[str]:
    """Return the names of a function and of those inside it, and its strings in quotes."""
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    strings = {repr(constant) for constant in code.co_consts if isinstance(constant, str)}
    return strings.union(code.co_names, *map(_words, inner))


def _words_of_calls(value, found: dict[object, set[str]]) -> set[str]:
    """Return the words of a function or class of the tests, and of those that it uses."""
    if value not in found:
        found[value] = set()
        functions = [v for v in vars(value).values() if inspect.isfunction(v)] if inspect.isclass(value) else [value]
        for function in functions:
            words, names = _words(function.__code__), function.__globals__
            used = (inspect.unwrap(names[word]) for word in words if callable(names.get(word)))
            own = [one for one in used if _is_of_tests(one)]
            found[value] = words.union(found[value], *(_words_of_calls(one, found) for one in own))
    return found[value]


def _is_of_tests(value) -> bool:
    """Return whether a value is a function or a class of the tests and their helpers."""
    if not (inspect.isfunction(value) or inspect.isclass(value)):
        return False
    place = getattr(sys.modules.get(value.__module__), "__file__", None)
    return place is not None and Path(place).is_relative_to(REPOSITORY / "tests")


def _add_marks(items, long: Container[Path]) -> None:
    """Mark the tests of long files, and those that start processes or train, by names in them, fixtures and helpers."""
    found: dict[object, set[str]] = {}
    for item in items:
        fixtures = [definitions[-1].func for definitions in item._fixtureinfo.name2fixturedefs.values()]
        own = [function for function in map(inspect.unwrap, (item.function, *fixtures)) if _is_of_tests(function)]
        if item.path in long:
            item.add_marker("slow")
        words = {repr(getattr(item, "callspec", None) and item.callspec.params)}
        words = words.union(*(_words_of_calls(function, found) for function in own))
        if any(map(PROCESSES.search, words)):
            item.add_marker("process")
        if any(map(TRAINING.fullmatch, words)):
            item.add_marker("training")


def pytest_collection_modifyitems(items):
    """Add marks, and run long files first; tests of a file keep their order."""
    place = {REPOSITORY / "tests" / name: k for k, name in enumerate(LONG)}
    if missing := [str(path) for path in place if not path.is_file()]:
        raise pytest.UsageError(f"LONG in tests/conftest.py names missing files: {missing}")
    _add_marks(items, place)
    items.sort(key=lambda item: place.get(item.path, len(LONG)))


def pytest_collection_finish():
    """Leave the modules and tests out of garbage collection, and collect less often: it takes a tenth of most runs."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


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
