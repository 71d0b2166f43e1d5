"""Recordings of the benchmark: parts, poses and classes."""

import dataclasses

import numpy as np
import pytest
from helpers.conf import CONF, base
from helpers.yaml_files import read_yaml
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.scenes.parts import TEST, TRAIN, Pose
from mlsroad_pipeline.papers.comparison.recordings.parameters import Source, sources_of
from mlsroad_pipeline.surveys.recordings import read_scene

CONFIG = read_yaml(CONF / "recordings/parameters.yml")["recordings_study"]
SOURCES = sources_of(CONFIG["sources"])
GAP = base("recordings_study")["gap"]


CODINGS = {name: codes for name, codes in base("classes")["codings"].items() if codes}


def test_a_file_without_a_pose_and_an_unknown_coding_are_named():
    source = dataclasses.replace(SOURCES["ika"], poses={"a": [1, 2, 3]})
    assert source.pose("a") == Pose(1, 2, 3)
    assert SOURCES["pandaset"].pose("00") is None
    with pytest.raises(ParameterError, match="ika.poses has no pose of 'b'"):
        source.pose("b")
    with pytest.raises(ParameterError, match="ika: coding 'ika' is not configured"):
        source.read_coding({})


def test_test_part_has_a_plane_or_blocks():
    with pytest.raises(ParameterError, match=r"sources.x.test .*got \['half'\]"):
        Source(name="x", title="X", files="*", coding="oakland", classes=[], scanner="s", licence="l", test={"half": 1})


def test_configuration_without_recordings_or_with_unknown_fields_is_refused():
    with pytest.raises(ParameterError, match="--env=recordings"):
        sources_of({})
    with pytest.raises(ParameterError, match=r"sources\.x: .*unexpected keyword argument 'colour'"):
        sources_of({"x": {"colour": 1}})


def test_a_missing_recording_is_named(tmp_path):
    with pytest.raises(ReadError, match="has no real/pandaset/.* \\(PandaSet 001\\): set recordings_study.root"):
        SOURCES["pandaset"].paths(tmp_path)


@pytest.mark.parametrize("name", SOURCES)
def test_codes_of_a_recording_fall_into_its_classes_or_are_ignored(name):
    source, scheme = SOURCES[name], ClassScheme.from_config("common", base("classes")["schemes"]["common"])
    coding = source.read_coding(CODINGS)
    labels = scheme.encode(coding.encode(list(coding.codes)))
    given = {scheme.classes[label] for label in labels if label >= 0}
    rare = {"wire", "person", "other"}  # in the coding, but hardly in the recording
    assert set(source.classes) <= given <= set(source.classes) | rare
    assert {coding.codes[code] for code in source.ignored} <= {"unlabelled"}
    assert all(held not in source.classes for others in source.mixed.values() for held in others)


def test_recordings_of_one_drive_are_divided_alike():
    first, second = SOURCES["semantickitti"], SOURCES["semantickitti_images"]
    assert first.test == second.test
    assert first.left_out == second.left_out
    assert [list(pose) for pose in first.poses.values()] == [list(second.poses[str(k)]) for k in range(3)]


@pytest.mark.real_data
@pytest.mark.parametrize("name", SOURCES)
def test_no_training_point_lies_within_five_metres_of_a_test_point_of_the_drive(name, real_data):
    source = SOURCES[name]
    try:
        paths = source.paths(real_data())
    except ReadError as error:
        pytest.skip(str(error))
    blocks = [str(path) for path in paths.values() if source.is_test_block(path)]
    stems = list(paths)
    chosen = stems[:: max(1, len(stems) // 3)]
    if blocks:  # all of the test part, and two training blocks with neighbours in it
        chosen = [
            stem for stem in stems if source.is_test_block(paths[stem]) or stem.endswith(("part2_ah", "part3_am"))
        ]
    sides = {TRAIN: [], TEST: []}
    for stem in chosen:
        path = paths[stem]
        labels = None if source.labels is None else str(path.parent / source.labels / f"{stem}.label")
        cloud = read_scene(
            str(path), labels, [] if source.is_test_block(path) else blocks,
            coding=source.read_coding(CODINGS), read=source.read, plane=source.plane, pose=source.pose(stem),
            is_test=source.is_test_block(path), gap=GAP,
        )  # fmt: skip
        world = cloud.world_xyz()
        if source.poses:
            world[:, :2] = source.pose(stem).placed(world[:, :2])
        for side, parts in sides.items():
            parts.append(world[cloud["part"] == side][::3])
    train, test = (np.concatenate(sides[side]) for side in (TRAIN, TEST))
    assert min(len(train), len(test)) > 1000
    distance, _ = cKDTree(test).query(train, distance_upper_bound=20.0)
    assert distance.min() >= 5.0
