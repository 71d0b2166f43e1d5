"""Search for the files of surveys and splits; files that hold no points are left out with their reason."""

import laspy
import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.algorithms.scenes.splits import split_config
from mlsroad_pipeline.surveys.discovery import find_point_files, find_split_files, no_points_reason
from mlsroad_pipeline.surveys.files import Survey
from mlsroad_pipeline.surveys.parameters import LabelParameters
from mlsroad_pipeline.surveys.plan import plan_labelling


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
    assert [(file.name, file.folder) for file in survey.listing().files] == [("a/one,two.las", "a"), ("c/d.laz", "c")]
    monkeypatch.setenv("HOME", str(tmp_path))
    assert [file.name for file in Survey.at(["~/a/b.las", "~/a/*.las"]).listing().files] == ["b.las", "one,two.las"]
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


def las(path, n=5):
    made = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    made.x = made.y = made.z = np.arange(n, dtype=float)
    made.write(path)
    return path


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.las", b"", "is empty (0 bytes)"),
        ("a.bin", b"", "is empty (0 bytes)"),
        ("a.las", b"<html>not found</html>", "is HTML or XML, not LAS"),
        ("a.e57", b"%PDF-1.4", "is PDF, not E57"),
        ("a.ply", b"solid cube", None),  # unknown: an error when it is read
        ("a.pcd", b"# This PCD file has another first line", None),
        ("labels.txt", b"1 car\n2 tree\n", "holds no row of three numbers"),
        ("readme.txt", b"Survey of 2024, two passes, north to south.\n", "holds no row of three numbers"),
        ("a.txt", b"1 2 3\n4 5 6\nDear Sir or Madam\n", None),  # a damaged table
        ("a.csv", b"x;y;z\n1,5;2,5;3,5\n", None),
        ("a.laz", b"LASF and no more", None),  # truncated
        ("a.laz", b"PK\x03\x04 packed", None),  # may hold points
    ],
)
def test_reason(tmp_path, name, content, reason):
    path = tmp_path / name
    path.write_bytes(content)
    assert no_points_reason(path) == reason


def test_clouds_are_kept_and_empty_ones_are_not(tmp_path):
    assert no_points_reason(las(tmp_path / "a.las")) is None
    assert no_points_reason(las(tmp_path / "b.las", n=0)) == "is a LAS file without points"


def test_a_delimiter_of_the_options_keeps_text_that_is_not_recognised(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1|2|3\n4|5|6\n")
    assert no_points_reason(path) and no_points_reason(path, text=False) is None


def planned(tmp_path, survey):
    return plan_labelling(LabelParameters(str(survey), str(tmp_path / "out")), IngestParameters())


@pytest.mark.parametrize("place", ["in", "in/*"])
def test_plan_has_the_clouds_and_the_reasons_of_the_others(tmp_path, place):
    folder = tmp_path / "in"
    (folder / "b").mkdir(parents=True)
    las(folder / "a.las")
    (folder / "b" / "empty.las").write_bytes(b"")
    (folder / "b" / "labels.txt").write_text("1 car\n")
    plan = planned(tmp_path, tmp_path / place)
    assert [file.source.name for file in plan.files] == ["a.las"]
    assert plan.skipped["b/empty.las"] == "is empty (0 bytes): skipped"
    assert set(plan.skipped) == {"b/empty.las", "b/labels.txt"} and plan.skipped["b/labels.txt"].endswith(": skipped")


def test_a_survey_without_any_points_is_an_error_with_the_reasons(tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("a.las", "b.laz"):
        (tmp_path / "in" / name).write_bytes(b"")
    with pytest.raises(ReadError, match=r"in holds no point cloud: a.las is empty \(0 bytes\); b.laz is empty"):
        planned(tmp_path, tmp_path / "in")


def test_a_file_that_is_named_is_not_skipped(tmp_path):
    las(tmp_path / "a.las")
    (tmp_path / "b.las").write_bytes(b"")
    listing = Survey.at([str(tmp_path / "b.las"), str(tmp_path / "*.las")]).listing()
    assert [file.name for file in listing.files] == ["a.las", "b.las"] and not listing.skipped
