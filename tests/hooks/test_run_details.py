"""Details of a run, without a tracking store."""

import subprocess
from dataclasses import dataclass
from enum import Enum

import pytest
from pydantic import BaseModel

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.hooks.run_details import (
    environment,
    fingerprint_files,
    flatten_parameters,
    git_state,
    short_parameters,
    source_files,
)


@dataclass(frozen=True)
class Forest:
    n_trees: int = 200
    depth: int | None = None


class Kind(Enum):
    LOKY = "loky"


class Execution(BaseModel):
    kind: Kind = Kind.LOKY
    forest: Forest = Forest()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"seed": 1}, {"seed": "1"}),
        ({"forest": Forest()}, {"forest.n_trees": "200", "forest.depth": "None"}),
        (
            {"run": Execution()},
            {"run.kind": "loky", "run.forest.n_trees": "200", "run.forest.depth": "None"},
        ),
        ({"splits": {"train": ["a/*", "b"]}}, {"splits.train": "['a/*', 'b']"}),
        ({"stages": [{"a": 1}, {"a": 2}]}, {"stages.0.a": "1", "stages.1.a": "2"}),
        ({"none": {}, "empty": []}, {"none": "{}", "empty": "[]"}),
        ({"classes": {"car & van": 1, "car % van": 2}}, {"classes.car _ van": "1", "classes.car _ van_2": "2"}),
        ({"rule": flatten_parameters}, {"rule": "mlsroad_pipeline.hooks.run_details.flatten_parameters"}),
    ],
)
def test_every_parameter_gets_a_name(given, expected):
    assert flatten_parameters(given) == expected
    assert list(flatten_parameters(given)) == list(expected)


def test_git_state_tells_the_commit_and_changes(tmp_path):
    def git(*arguments):
        identity = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
        command = ["git", "-C", str(tmp_path), *identity, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    assert git_state(tmp_path / "nowhere") == {}
    git("init", "-q")
    assert git_state(tmp_path) == {}
    git("commit", "-q", "--allow-empty", "-m", "first")
    assert git_state(tmp_path) == {"git.commit": git("rev-parse", "HEAD"), "git.dirty": "false"}
    (tmp_path / "a.txt").write_text("a")
    assert git_state(tmp_path)["git.dirty"] == "true"


def test_environment_lists_what_is_installed():
    tags, frozen = environment()
    assert tags["python"].startswith("3.")
    assert any(line.startswith("numpy==") for line in frozen)
    assert frozen == sorted(frozen, key=str.lower)


@pytest.fixture
def survey(tmp_path):
    (tmp_path / "a" / "sub").mkdir(parents=True)
    paths = [tmp_path / "a" / "one.laz", tmp_path / "a" / "sub" / "two.laz"]
    for k, path in enumerate(paths):
        path.write_bytes(bytes([k] * 10))
    return paths


def test_fingerprint_depends_on_content_and_names_alone(survey, tmp_path):
    first = fingerprint_files(survey)
    assert [file["path"] for file in first["files"]] == ["one.laz", "sub/two.laz"]
    assert fingerprint_files([*reversed(survey), survey[0]]) == first
    (tmp_path / "a").rename(tmp_path / "elsewhere")
    moved = [tmp_path / "elsewhere" / "one.laz", tmp_path / "elsewhere" / "sub" / "two.laz"]
    assert fingerprint_files(moved)["digest"] == first["digest"]
    moved[0].write_bytes(b"other text")
    assert fingerprint_files(moved)["digest"] != first["digest"]


def test_fingerprint_table_is_small_and_complete(survey):
    table = fingerprint_files(survey)
    assert (table["n_files"], table["bytes"]) == (2, 20)
    assert set(table["files"][0]) == {"path", "bytes", "blake2b"}
    assert len(table["digest"]) == 32


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ReadError, match=r"gone.laz: cannot be fingerprinted"):
        fingerprint_files([tmp_path / "gone.laz"])


def test_raw_files_are_found_among_the_inputs_of_tasks():
    @dataclass
    class Source:
        path: str

    @dataclass
    class Task:
        inputs: dict

    tasks = {"s1": Task({"a": Source("b.laz"), "n": 3}), "s2": Task({"l": [Source("a.laz"), {"x": Source("b.laz")}]})}
    assert source_files(tasks) == ["a.laz", "b.laz"]
    assert source_files({"s1": 3}) == []
    assert source_files(None) == []


def test_class_schemes_and_the_largest_sections_are_digests():
    flat = {f"classes.schemes.{k}": str(k) for k in range(430)} | {f"simulation.{k}": "1" for k in range(50)}
    flat |= {"forest.n_trees": "100", "forest.depth": "7", "seed": "3"}
    short = short_parameters(flat)
    assert set(short) == {
        *(f"simulation.{k}" for k in range(50)),
        "classes.digest",
        "forest.n_trees",
        "forest.depth",
        "seed",
    }
    other = short_parameters({**flat, "classes.schemes.7": "x"})
    assert (
        other["classes.digest"] != short["classes.digest"]
        and {**other, "classes.digest": short["classes.digest"]} == short
    )
    few = short_parameters(flat, most=10)
    assert set(few) == {"simulation.digest", "classes.digest", "forest.n_trees", "forest.depth", "seed"}
