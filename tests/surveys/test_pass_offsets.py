"""Offsets between files and passes of a survey, copies and buffers, and what `inspect` says of them."""

import shutil

import numpy as np
import pytest
from helpers.twin_streets import street, write_pass

from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.surveys.files import Survey
from mlsroad_pipeline.surveys.inspection import InspectParameters, inspect_survey, offsets_of_files
from mlsroad_pipeline.surveys.offset_warnings import offset_facts, offset_warnings

DAY = 86_400.0


def offsets(folder):
    parameters = InspectParameters(survey=str(folder), trajectory=None)
    files, skipped = inspect_survey(parameters, root=str(folder), read={})
    assert not skipped and len(files) == len(Survey.at(folder).listing(trajectory=None).files)
    return offsets_of_files(parameters, files, read={})


def test_shifted_pass_is_named_with_metres(tmp_path):
    write_pass(tmp_path / "a.laz", street(1), 1000.0)
    write_pass(tmp_path / "b.laz", street(2) + [0.3, -0.4, 0.2], 1000.0 + DAY)
    found = offsets(tmp_path)
    (fact,) = offset_facts(found)
    assert (fact["file"], fact["other"]) == ("b.laz", "a.laz")
    np.testing.assert_allclose([fact[name] for name in ("east", "north", "up")], [0.3, -0.4, 0.2], atol=0.02)
    ((name, text),) = offset_warnings(found)
    assert name == "b.laz"
    assert text.startswith("lies 0.50 m aside (+0.30 m east, -0.40 m north) and 0.20 m above a.laz")
    assert "label.align_passes=true" in text
    np.testing.assert_allclose(found.moves[0].shift, 0, atol=1e-3)  # the first of two equals stays
    np.testing.assert_allclose(found.moves[1].shift, [-0.3, 0.4, -0.2], atol=0.02)
    ((_, after),) = offset_warnings(found, aligned=True)
    assert "0.00 m in plan and 0.00 m in height remain" in after.replace("0.01", "0.00")
    assert "written points keep their coordinates" in after


def test_passes_in_one_file_are_told_apart_by_their_times(tmp_path):
    first, second = street(1), street(2) + [0.0, 0.0, 0.3]
    both = np.concatenate([first, second])
    write_pass(tmp_path / "both.laz", both, 0.0)
    cloud = LasFormat().read(tmp_path / "both.laz", ReadOptions())
    time = cloud["gps_time"] + np.where(np.argsort(both[:, 0]) >= len(first), 600.0, 0.0)
    LasFormat().write(tmp_path / "both.laz", cloud.with_columns(gps_time=time), WriteOptions(like="none"))
    (fact,) = offset_facts(offsets(tmp_path))
    assert (fact["file"], fact["other"]) == ("both.laz (pass 2)", "both.laz (pass 1)")
    assert fact["up"] == pytest.approx(0.3, abs=0.02)


def test_undisturbed_passes_say_nothing(tmp_path):
    write_pass(tmp_path / "a.laz", street(1), 1000.0)
    write_pass(tmp_path / "b.laz", street(2), 1000.0 + DAY)
    found = offsets(tmp_path)
    assert len(found.pairs) == 1
    assert offset_warnings(found) == []
    assert all(move.is_small for move in found.moves)


def test_copy_of_a_file_is_named(tmp_path):
    write_pass(tmp_path / "survey.laz", street(1), 1000.0)
    shutil.copy(tmp_path / "survey.laz", tmp_path / "survey - Copy.laz")
    ((name, text),) = offset_warnings(offsets(tmp_path))
    assert name == "survey.laz"
    assert text.startswith("has the same points as survey - Copy.laz, a copy: objects are listed once")


def test_buffers_of_tiles_are_named(tmp_path):
    points = street(1)
    write_pass(tmp_path / "a.laz", points[points[:, 0] < 34], 1000.0)
    write_pass(tmp_path / "b.laz", points[points[:, 0] > 26], 1000.0)
    ((_, text),) = offset_warnings(offsets(tmp_path))
    assert "are the same points, as in buffers of tiles" in text


def test_a_tile_with_other_heights_is_named_at_its_border(tmp_path):
    points = street(1)
    for name, low, high, up in (("a", 0, 20, 0.0), ("b", 20, 40, 40.0), ("c", 40, 60, 0.0)):
        own = points[(points[:, 0] >= low) & (points[:, 0] < high)]
        write_pass(tmp_path / f"{name}.laz", own + [0.0, 0.0, up], 1000.0)
    found = offsets(tmp_path)
    lines = offset_warnings(found)
    assert len(lines) == 2
    assert all("its ground lies" in text and "at their border" in text for _, text in lines)
    heights = [move.shift[2] for move in found.moves]
    np.testing.assert_allclose(heights, [0, -40, 0], atol=0.3)


def test_a_single_file_of_one_pass_is_not_read_again(tmp_path, monkeypatch):
    write_pass(tmp_path / "a.laz", street(1), 1000.0)
    monkeypatch.setattr("mlsroad_pipeline.surveys.inspection.survey_offsets", None)
    assert offsets(tmp_path).pairs == ()
