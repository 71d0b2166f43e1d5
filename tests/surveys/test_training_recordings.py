"""Recordings that a model of the package is trained on: files, digest, classes."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.surveys.recordings import TrainingRecording, described_recordings, digest

FIELDS = {"title": "A drive", "files": "drive/*.npz", "coding": "own", "licence": "MIT", "ignored": [7]}


@pytest.fixture
def root(tmp_path):
    (tmp_path / "drive").mkdir()
    for number in range(2):
        np.savez(tmp_path / f"drive/{number}.npz", xyz=np.full((1, 3), number))
    return tmp_path


def recording(root, **changes):
    sha256 = digest(list((root / "drive").iterdir()))
    return TrainingRecording.configured({"drive": {**FIELDS, "sha256": sha256, **changes}})["drive"]


def test_files_are_found_in_order_and_their_digest_depends_on_names_and_contents(root):
    files = recording(root).paths(root)
    assert list(files) == ["0", "1"]
    before = digest(list(files.values()))
    assert digest(list(reversed(files.values()))) == before
    files["0"].rename(root / "drive/2.npz")
    assert digest(list((root / "drive").iterdir())) != before


def test_missing_and_other_files_are_named(root):
    with pytest.raises(ReadError, match=r"has no none/\*.npz: put A drive there, or set MLSROAD_DATA to the folder "):
        recording(root, files="none/*.npz").paths(root)
    with pytest.raises(ReadError, match=r"drive/\*.npz: the files of A drive are not those of the model \(SHA256 "):
        recording(root, sha256="0" * 64).paths(root)


def test_two_files_of_one_name_are_an_error(root):
    (root / "drive2").mkdir()
    (root / "drive/0.npz").rename(root / "drive2/1.npz")
    with pytest.raises(ReadError, match=r"drive/1.npz and .*drive2/1.npz have the same name: \*/\*.npz may name one"):
        recording(root, files="*/*.npz").paths(root)


def test_ignored_codes_are_unlabelled_and_unknown_names_are_errors(root):
    coding = recording(root).read_coding({"own": {1: "road", 7: "building"}})
    assert coding.encode(np.array([1, 7])).tolist() == [coding.encode(np.array([1]))[0], 0]
    with pytest.raises(ParameterError, match=r"shipped.recordings.drive: coding 'own' is not configured"):
        recording(root).read_coding({})
    with pytest.raises(ParameterError, match=r"shipped.recordings.drive: .*'colour'"):
        recording(root, colour="red")


def test_registry_entry_counts_scenes_of_each_recording(root):
    config = {"drive": {**FIELDS, "sha256": "ab"}}
    facts = described_recordings(config, ["drive.0", "drive.1", "other.0"])
    assert facts == {"drive": {"title": "A drive", "licence": "MIT", "scenes": 2, "sha256": "ab"}}
