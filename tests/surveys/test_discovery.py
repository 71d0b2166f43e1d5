"""Finding surveys and splits."""

import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.surveys.discovery import find_surveys, resolve_splits


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
        ("", "*.la[sz]", ["a.las", "b.laz"]),
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
    assert names_in(root, find_surveys(root / below, patterns)) == expected
    assert names_in(root, find_surveys(str(root / below), patterns)) == expected


def test_nothing_found(root):
    with pytest.raises(ReadError, match=r"nowhere does not exist"):
        find_surveys(root / "nowhere")
    with pytest.raises(ReadError, match=r"no point cloud found in .* with \*\.pcd \(extensions: .*\.laz"):
        find_surveys(root, "*.pcd")
    with pytest.raises(ReadError, match=r"no point cloud found in .*\*\.json"):
        find_surveys(root / "part" / "*.json")
    with pytest.raises(ParameterError, match=r"pattern '\.\./\*' must stay below"):
        find_surveys(root / "part", "../*")


def test_splits(root):
    splits = resolve_splits(root, {"train": "*.laz", "test": ["part/*", "a.las"]})
    assert {name: names_in(root, paths) for name, paths in splits.items()} == {
        **{"train": ["b.laz"], "test": ["a.las", "part/c.txt.gz", "part/deep/d.PLY"]}
    }
    with pytest.raises(ParameterError, match=r"a\.las is in two splits: 'train' and 'test'"):
        resolve_splits(root, {"train": "*.la*", "test": "a.las"})
    with pytest.raises(ReadError, match=r"split 'test' matches nothing: .*south/\*"):
        resolve_splits(root, {"train": "*.laz", "test": "south/*"})
    with pytest.raises(ParameterError, match=r"split 'test' has no patterns"):
        resolve_splits(root, {"test": []})
    with pytest.raises(ParameterError, match=r"at least one split"):
        resolve_splits(root, {})
    with pytest.raises(ReadError, match=r"a\.las is not a folder"):
        resolve_splits(root / "a.las", {"test": "*"})
