"""Search for the files of surveys and splits."""

import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.scenes.splits import split_config
from mlsroad_pipeline.surveys.discovery import find_point_files, find_split_files
from mlsroad_pipeline.surveys.files import Survey


@pytest.fixture
def root(tmp_path):
    names = [
        "b.laz",
        "a.las",
        "part/c.txt.gz",
        "part/deep/d.PLY",
        "part/calibration.json",
        ".hidden/e.las",
        "part/.f.las",
    ]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    return tmp_path


def names_in(root, paths):
    return [str(path.relative_to(root)) for path in paths]


@pytest.mark.parametrize(
    ("below", "patterns", "expected"),
    [
        ("", None, ["a.las", "b.laz", "part/c.txt.gz", "part/deep/d.PLY"]),
        ("", ["*.la[sz]"], ["a.las", "b.laz"]),
        ("", ["part/*", "a.las"], ["a.las", "part/c.txt.gz", "part/deep/d.PLY"]),
        ("", ["*.las", "a.*"], ["a.las"]),
        ("part", None, ["part/c.txt.gz", "part/deep/d.PLY"]),
        ("a.las", None, ["a.las"]),
        ("part/calibration.json", None, ["part/calibration.json"]),
        ("*.las", None, ["a.las"]),
        ("pa*", None, ["part/c.txt.gz", "part/deep/d.PLY"]),
        ("**/*.PLY", None, ["part/deep/d.PLY"]),
    ],
)
def test_file_folder_and_glob(root, below, patterns, expected):
    assert names_in(root, find_point_files(root / below, patterns)) == expected
    assert names_in(root, find_point_files(str(root / below), patterns)) == expected


def test_links_to_folders_are_followed_except_loops(root, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "g.las").write_bytes(b"x")
    (root / "part" / "other").symlink_to(elsewhere)
    for loop in ("back", "again"):
        (root / "part" / loop).symlink_to(root)
        (elsewhere / loop).symlink_to(".")
    (root / "itself.las").symlink_to("itself.las")
    expected = ["a.las", "b.laz", "part/c.txt.gz", "part/deep/d.PLY", "part/other/g.las"]
    assert names_in(root, find_point_files(root)) == expected


def test_nothing_found(root):
    with pytest.raises(ReadError, match=r"nowhere does not exist"):
        find_point_files(root / "nowhere")
    with pytest.raises(ReadError, match=r"no point cloud found in .* with \*\.pcd \(extensions: .*\.laz"):
        find_point_files(root, ["*.pcd"])
    with pytest.raises(ReadError, match=r"no point cloud found in .*\*\.json"):
        find_point_files(root / "part" / "*.json")
    with pytest.raises(ParameterError, match=r"pattern '\.\./\*' must stay below"):
        find_point_files(root / "part", ["../*"])


def split_files(root, splits):
    return Survey.at(root).split_files({name: split_config(value) for name, value in splits.items()})


def test_splits(root):
    splits = split_files(root, {"train": "*.laz", "test": ["part/*", "a.las"]})
    assert {name: [file.name for file in files] for name, files in splits.items()} == {
        **{"train": ["b.laz"], "test": ["a.las", "part/c.txt.gz", "part/deep/d.PLY"]}
    }
    assert names_in(root, find_split_files(root, "train", ["*.laz"])) == ["b.laz"]
    with pytest.raises(ParameterError, match=r"'train' and 'test' share a\.las: each point belongs to one split"):
        split_files(root, {"train": "*.la*", "test": "a.las"})
    with pytest.raises(ReadError, match=r"split 'test' matches nothing: .*south/\*"):
        split_files(root, {"train": "*.laz", "test": "south/*"})
    with pytest.raises(ParameterError, match=r"split 'test' has no patterns"):
        split_files(root, {"test": []})
    with pytest.raises(ParameterError, match=r"at least one split"):
        split_files(root, {})
    with pytest.raises(ReadError, match=r"a\.las is not a folder"):
        split_files(root / "a.las", {"test": "*"})


def test_a_survey_of_several_places_is_named_below_their_common_folder(tmp_path, monkeypatch):
    for name in ("a/one,two.las", "a/b.las", "c/d.laz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"LASF")
    survey = Survey.at([tmp_path / "a" / "one,two.las", tmp_path / "c"])
    assert [(file.name, file.folder) for file in survey.files()] == [("a/one,two.las", "a"), ("c/d.laz", "c")]
    monkeypatch.setenv("HOME", str(tmp_path))
    assert [file.name for file in Survey.at(["~/a/b.las", "~/a/*.las"]).files()] == ["b.las", "one,two.las"]
    with pytest.raises(ParameterError, match="at least one file, folder or glob, got none"):
        Survey.at([])


def test_globs_over_folders_leave_hidden_ones_out_unless_they_are_named(root):
    assert names_in(root, find_point_files(root / "**" / "*.las")) == ["a.las"]
    assert names_in(root, find_point_files(root / "**" / ".hidden" / "*.las")) == [".hidden/e.las"]


def test_brackets_in_the_name_of_a_folder_are_no_pattern(tmp_path):
    root = tmp_path / "[2024] x"
    (root / "a").mkdir(parents=True)
    (root / "a" / "p.laz").write_bytes(b"x")
    assert names_in(root, find_split_files(root, "train", ["a/*.laz"])) == ["a/p.laz"]
    assert Survey.at(root / "a" / "p.laz").folder == root / "a"
