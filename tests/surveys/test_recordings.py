"""Recordings: scenes from small files, training files and their digest."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.codings import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.scenes.parts import NEITHER, TEST, TRAIN, HalfPlane, Pose
from mlsroad_pipeline.surveys.recordings import TrainingRecording, described_recordings, digest, read_scene

CODING = Coding("toy", {0: "unlabelled", 1: "road", 2: "building", 3: "outlier"})
XYZ = np.array([[-9.0, 0, 0], [-1.0, 0, 0], [9.0, 0, 0], [10.0, 1, 2]])


def read(path, labels=None, blocks=(), **changes):
    given = {"coding": CODING, "read": {}, "plane": HalfPlane(0, 0), "pose": None, "is_test": False, "gap": 6.0}
    return read_scene(str(path), labels, blocks, **{**given, **changes})


def write_npz(path):
    np.savez(path, xyz=XYZ.astype(np.float32), intensity=np.float32([0, 51, 255, 1]), label=np.uint8([1, 1, 2, 3]),
             ring=np.zeros(4, np.uint8))  # fmt: skip
    return str(path)


def test_npz_scan_has_parts_and_classes(tmp_path):
    path = write_npz(tmp_path / "7.npz")
    cloud = read(path)
    assert sorted(cloud.columns) == ["intensity", "label", "part"]
    assert cloud["part"].tolist() == [TRAIN, NEITHER, TEST, TEST]
    assert cloud["intensity"] == pytest.approx([0, 0.2, 1, 1 / 255])
    names = ("road", "road", "building", "outlier")
    assert cloud["label"].tolist() == [TAXONOMY[name] for name in names]


def test_pose_of_the_scan_decides_its_part(tmp_path):
    path = write_npz(tmp_path / "7.npz")
    assert (read(path, pose=Pose(-20.0, 0.0, 0.0))["part"] == TRAIN).all()


def test_kitti_scan_takes_labels_from_their_own_folder(tmp_path):
    (tmp_path / "label").mkdir()
    scan, labels = tmp_path / "000000.bin", tmp_path / "label/000000.label"
    np.c_[XYZ, np.full(4, 0.5)].astype("<f4").tofile(scan)
    np.array([1, 1 | 5 << 16, 2, 0], "<u4").tofile(labels)
    cloud = read(scan, str(labels))
    assert cloud["label"].tolist() == [TAXONOMY[name] for name in ("road", "road", "building", "unlabelled")]
    np.array([1, 1], "<u4").tofile(labels)
    with pytest.raises(ReadError, match="has 2 labels for the 4 points of .*000000.bin"):
        read(scan, str(labels))


def test_points_of_a_training_block_near_a_test_block_belong_to_neither_part(tmp_path):
    train, test = tmp_path / "a.npz", tmp_path / "b.npz"
    write_npz(train)
    np.savez(test, xyz=np.array([[-4.0, 0, 0]]), label=np.uint8([1]), intensity=np.float32([1]))
    cloud = read(train, blocks=[str(test)], plane=None, gap=4.0)
    assert cloud["part"].tolist() == [TRAIN, NEITHER, TRAIN, TRAIN]
    assert read(test, plane=None, is_test=True)["part"].tolist() == [TEST]


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
