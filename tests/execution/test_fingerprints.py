"""A fingerprint changes if and only if a result has to be computed again."""

import enum
import functools
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers import store as store_helpers
from helpers.store import give, make_points, square
from sklearn.tree import DecisionTreeClassifier

from mlsroad_pipeline.algorithms.core import validation
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.segmentation import euclidean
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.execution import fingerprints
from mlsroad_pipeline.execution.digests import digest_file
from mlsroad_pipeline.execution.fingerprints import Fingerprinter, describe_sources, package_versions, qualified_name
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, StoredResult
from mlsroad_pipeline.pipelines.label import nodes as pipeline_nodes


@dataclass(frozen=True)
class Settings:
    size: float
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class OtherSettings:
    size: float
    names: tuple[str, ...] = ()


class Colour(enum.Enum):
    RED = 1
    BLUE = 2


def of(**parameters):
    return Fingerprinter().task(give, {}, parameters)


EQUAL = [
    (np.float64(0.1), 0.1),
    (np.int32(3), 3),
    (np.bool_(True), True),
    ((1, 2), [1, 2]),
    (Path("a/b"), "a/b"),
    ({"b", "a"}, {"a", "b"}),
    (Settings(1.0, ("x",)), Settings(1.0, ("x",))),
    (np.arange(3), np.arange(3)),
    (float("nan"), np.nan),
    (DecisionTreeClassifier(max_depth=2), DecisionTreeClassifier(max_depth=2)),
]
DIFFERENT = [
    (0.1, 0.1 + 1e-16 * 2),
    (np.float32(0.1), 0.1),
    (1, True),
    (1, 1.0),
    ("1", 1),
    (None, "None"),
    ([1, [2]], [1, 2]),
    ({"a": 1, "b": 2}, {"b": 2, "a": 1}),  # the order of a class scheme numbers its labels
    ({1: "a"}, {"1": "a"}),
    ({"a"}, ["a"]),
    (Settings(1.0), Settings(2.0)),
    (Settings(1.0), OtherSettings(1.0)),
    (Colour.RED, Colour.BLUE),
    (np.arange(3), np.arange(3.0)),
    (np.arange(4), np.arange(4).reshape(2, 2)),
    (make_points, square),
    (DecisionTreeClassifier(max_depth=2), DecisionTreeClassifier(max_depth=3)),
]


@pytest.mark.parametrize(("one", "other"), EQUAL)
def test_same_meaning_gives_same_fingerprint(one, other):
    assert of(value=one) == of(value=other)


@pytest.mark.parametrize(("one", "other"), DIFFERENT)
def test_another_value_gives_another_fingerprint(one, other):
    assert of(value=one) != of(value=other)


def test_order_of_keyword_arguments_does_not_count():
    assert of(a=1, b=2) == of(b=2, a=1)


def test_a_parameter_is_not_an_input():
    assert Fingerprinter().task(give, {"value": 1}, {}) != Fingerprinter().task(give, {}, {"value": 1})


def test_function_and_validator_count():
    plain = Fingerprinter().task(give, {}, {"value": 1})
    assert Fingerprinter().task(make_points, {}, {"value": 1}) != plain
    assert Fingerprinter().task(give, {}, {"value": 1}, validator=store_helpers.refuse_negative) != plain


def test_source_file_counts_by_name_and_content(tmp_path):
    first, moved, renamed, edited = (tmp_path / p for p in ("a/f.txt", "b/f.txt", "a/g.txt", "c/f.txt"))
    for path, text in [(first, "x"), (moved, "x"), (renamed, "x"), (edited, "y")]:
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    digests = [Fingerprinter().task(give, {"value": SourceFile(str(p))}, {}) for p in (first, moved, renamed, edited)]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3


def test_folder_counts_with_all_its_files(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a").write_text("1")
    before = digest_file(str(tmp_path))
    assert digest_file(str(tmp_path)) == before
    (tmp_path / "b").write_text("1")
    assert digest_file(str(tmp_path)) != before


def test_file_is_read_again_only_when_it_changed(tmp_path, monkeypatch):
    path = tmp_path / "f"
    path.write_text("1")
    before = digest_file(str(path))
    state = os.stat(path)
    path.write_text("2")
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert digest_file(str(path)) == before  # size and time are all that is looked at
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + 1))
    assert digest_file(str(path)) != before


def test_missing_source_file_is_named(tmp_path):
    with pytest.raises(ReadError, match=r"gone\.laz: cannot be read"):
        Fingerprinter().task(give, {"value": SourceFile(str(tmp_path / "gone.laz"))}, {})


def test_stored_result_counts_by_content_not_by_place():
    results = [StoredResult("/a", "s", "f1"), StoredResult("/b", "t", "f1"), StoredResult("/a", "s", "f2")]
    digests = [Fingerprinter().task(give, {"value": [r]}, {}) for r in results]
    assert digests[0] == digests[1] != digests[2]


def test_sources_and_versions_count(monkeypatch):
    before = of(value=1)
    monkeypatch.setattr(fingerprints, "package_versions", lambda: {"numpy": "0.1"})
    assert of(value=1) != before
    monkeypatch.undo()
    monkeypatch.setattr(fingerprints, "describe_sources", lambda modules: ["edited"])
    assert of(value=1) != before
    assert package_versions()["numpy"] == np.__version__


def test_the_whole_library_counts_for_functions_outside_of_the_science():
    library, own = describe_sources([store_helpers.__name__])
    assert library[0] == "library"
    assert ["algorithms/core/validation.py", digest_file(validation.__file__)] in library[1]
    assert {"simulation", "papers", "formats", "label"} <= {name.partition("/")[0] for name, _ in library[1]}
    assert own == ["store.py", digest_file(store_helpers.__file__)]
    assert describe_sources([fingerprints.__name__]) == [library]
    edge = describe_sources([pipeline_nodes.__name__])
    assert edge[0] == library
    assert edge[1][0] == pipeline_nodes.__name__
    assert {"nodes.py", "pipeline.py"} <= {name for name, _ in edge[1][1]}


def test_of_the_science_those_count_that_are_imported():
    [(_, reached)] = describe_sources([euclidean.__name__])
    names = [name for name, _ in reached]
    assert {
        "algorithms/__init__.py",
        "algorithms/segmentation/__init__.py",
        "algorithms/segmentation/euclidean.py",
        "algorithms/core/validation.py",
    } <= set(names)
    assert names == sorted(names)
    assert "simulation/runtime/survey.py" not in names


def test_the_type_of_a_parameter_counts_with_what_it_can_reach():
    def sources_of(**parameters):
        seen = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(fingerprints, "describe_sources", lambda modules: seen.append(modules) or [])
            Fingerprinter().task(euclidean.cluster, {}, parameters)
        return seen[0]

    assert sources_of(tolerance=1.0) == (euclidean.__name__,)
    cut = sources_of(options=[SegmentationParameters()])
    assert cut == (
        euclidean.__name__,
        "mlsroad_pipeline.algorithms.segmentation.normalized_cut",
        "mlsroad_pipeline.algorithms.segmentation.stage",
        "mlsroad_pipeline.algorithms.segmentation.two_step",
        "mlsroad_pipeline.algorithms.segmentation.yang_dong",
    )


def closure():
    def inner():
        return None

    return inner


@pytest.mark.parametrize(
    "function", [lambda: 1, closure(), functools.partial(give, value=1), Settings(1.0).__eq__, DecisionTreeClassifier()]
)
def test_function_that_carries_more_than_its_name_is_refused(function):
    with pytest.raises(ParameterError, match="needs a function that a module defines at its top level"):
        qualified_name(function)


def test_value_that_cannot_be_pickled_is_refused():
    with pytest.raises(ParameterError, match=r"a value of _thread\.lock cannot be part of a scene task"):
        import threading

        of(value=threading.Lock())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"inputs": {"value": 1}, "parameters": {"value": 1}}, r"\['value'\] are both inputs and parameters"),
        ({"inputs": {"value": 1, "cloud": 1}}, "got an unexpected keyword argument 'cloud'"),
        ({}, "missing a required (keyword-only )?argument: 'value'"),
        ({"parameters": {"value": SourceFile("f")}}, "'value' is a SourceFile: pass it as an input"),
    ],
)
def test_task_that_cannot_be_called_is_refused(arguments, message):
    with pytest.raises(ParameterError, match=message):
        SceneTask(give, **arguments)
