"""Warnings on a survey: each problem is named, once per cause, by `inspect` and by the plan of `label` alike."""

from dataclasses import replace

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.quality.chunks import inspect_chunk, merge
from mlsroad_pipeline.algorithms.quality.density import cell_positions, count_places
from mlsroad_pipeline.algorithms.quality.report import QualityReport
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.surveys.survey_warnings import (
    AS_POINTS,
    SurveyFacts,
    file_warnings,
    looks_like_degrees,
    survey_warnings,
)

UTM = parse_crs("EPSG:25832")


def facts(xyz, name="a.laz", crs=UTM, columns=None, **changes):
    full = {"rgb": np.zeros((len(xyz), 3), np.uint8), "gps_time": np.linspace(0, 0.5, len(xyz))}
    given = {**full, "intensity": np.linspace(0, 1, len(xyz), dtype=np.float32), **(columns or {})}
    quality = merge([inspect_chunk(PointCloud(np.asarray(xyz, dtype=float), given, source=name))])
    return SurveyFacts(quality, crs, "LAS", **{"trajectory": "beside", **changes})


@pytest.fixture
def street(rng):
    return np.round(rng.random((500, 3)) * [40, 20, 8], 3)


def test_a_good_file_has_no_warning(street):
    assert file_warnings(facts(street)) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"crs": None}, "no coordinate reference system"),
        ({"crs": parse_crs("EPSG:2263")}, "has the unit US survey foot"),
        ({"crs": parse_crs("EPSG:4326")}, "look like degrees"),
        ({"trajectory": "none"}, "no trajectory"),
        ({"columns": {"intensity": np.linspace(0, 255 / 65535, 500, dtype=np.float32)}}, "intensity has 8 bits"),
        ({"columns": {"withheld": np.arange(500) < 7}}, "7 points are flagged withheld"),
        ({"whole_numbers": True}, "coordinates are whole numbers"),
        ({"constant": ("rgb",)}, "column rgb has a single value"),
        ({"stated_crs": parse_crs("EPSG:25833")}, "replaces the coordinate reference system ETRS89 / UTM zone 33N"),
        ({"notes": ("the trajectory is short",)}, "the trajectory is short"),
    ],
)
def test_each_problem_is_one_sentence(street, changes, message):
    found = file_warnings(facts(street, **changes))
    assert len(found) == 1 and message in found[0], found


@pytest.mark.parametrize(
    ("place", "crs", "message"),
    [
        ((690_000, 5_335_000), "EPSG:25832", None),  # Munich
        ((1_000_000, 5_350_000), "EPSG:25832", None),  # Vienna, in the zone beside its own
        ((5_335_000, 690_000), "EPSG:25832", "outside the area of ETRS89 / UTM zone 32N, at longitude "),
        ((690_000, 5_335_000), "EPSG:28992", "outside the area of Amersfoort / RD New, at "),
        ((5e9, 5_335_000), "EPSG:25832", "outside the area of ETRS89 / UTM zone 32N, at no place on the earth"),
        ((690_000, 5_335_000), "+proj=utm +zone=32 +datum=WGS84 +type=crs", None),  # has no area
        ((1_860_000, 5_750_000), "EPSG:2193", None),  # New Zealand; the area goes over the date line
    ],
)
def test_points_outside_the_area_of_their_system_are_named(street, place, crs, message):
    found = file_warnings(facts(street + [*place, 0], crs=parse_crs(crs)))
    assert [message in text for text in found] == [True] if message else found == []


@pytest.mark.parametrize(("offset", "warned"), [([5e9, 0, 0], True), ([33_389_300, 5_819_700, 0], False)])
def test_coordinates_beyond_any_map_system_are_named(street, offset, warned):
    found = file_warnings(facts(street + offset, crs=None))
    assert any("reach 5e+09 m, farther than those of any map system" in text for text in found) == warned


def test_points_in_two_places_are_counted(street):
    found = file_warnings(facts(np.concatenate([street, street + [9000, 0, 0]])))
    assert any("the points lie in 2 places more than 500 m apart" in text for text in found)


def test_a_cause_of_many_files_is_one_line_with_their_number_and_the_first(street):
    files = [facts(street, name=f"{k}.laz", crs=None, columns={"withheld": np.arange(500) < k}) for k in range(4)]
    found = survey_warnings(files, {"empty.laz": "is empty (0 bytes): skipped", "b.laz": "is empty (0 bytes): skipped"})
    assert found == [
        ("2 of 6 files, the first empty.laz", "is empty (0 bytes): skipped"),
        (
            "4 of 6 files, the first 0.laz",
            "no coordinate reference system: results have no position on a map; set crs (label.crs, --crs)",
        ),
        (
            "3 of 6 files, the first 1.laz",
            "1 points are flagged withheld: not used; they keep their class, with confidence 0",
        ),
    ]


def test_files_of_a_folder_that_lie_apart_and_differ(street):
    here, there = facts(street, name="run/a.laz"), facts(street + [20_000, 0, 0], name="run/b.laz", crs=None)
    found = dict(survey_warnings([here, there], {}))
    assert "2 files of the folder lie in 2 places more than 500 m apart" in found["run/"]
    assert "files have different coordinate reference systems" in found["run/a.laz"]
    assert "run/" not in dict(survey_warnings([here, replace(there, quality=here.quality)], {}))


def test_a_file_named_as_a_trajectory_beside_others_is_named(street):
    def warned(*names):
        return [
            name
            for name, text in survey_warnings([facts(street, name=name) for name in names], {})
            if text == AS_POINTS
        ]

    assert warned("lane/points.xyz", "lane/filter_Trajectory.xyz") == ["lane/filter_Trajectory.xyz"]
    assert warned("trajectory/a.laz", "trajectory/b.laz") == []
    assert warned("trajectory.laz") == []


def test_report_survives_the_table(street):
    report = facts(street, columns={"label": np.ones(500, np.uint8)}).quality
    assert QualityReport.from_row(report.as_row()) == report


def test_places_against_their_definition():
    """Cells of 500 m that touch are one place; positions come back from the keys of cells, negative ones too."""
    corners = np.array([[-3, -2], [-3, 5], [7, -1], [120_000, 5_400_000]])
    keys = (corners[:, 0] << 32) + corners[:, 1]
    assert np.array_equal(cell_positions(keys, 1.0), corners)
    assert count_places(np.zeros((0, 2))) == 0 and count_places(np.array([[1.0, 1.0]])) == 1
    chain = np.column_stack([np.arange(0, 50_000, 400.0), np.arange(0, 50_000, 400.0)])
    assert count_places(chain) == 1 and count_places(np.concatenate([chain, chain + [0, 2_000_000]])) == 2


@pytest.mark.parametrize(
    ("high", "degrees"),
    [
        ([9.045, 48.02, 130.0], True),
        ([9.0001, 48.0001, 102.0], True),
        ([40.0, 60.0, 130.0], False),
        ([9.04, 48.02, 100.5], False),
    ],
)
def test_five_kilometres_in_degrees_are_recognised(high, degrees):
    assert looks_like_degrees(np.array([9.0, 48.0, 100.0]), np.array(high)) == degrees
