"""The inspection of files with planted faults, and its report."""

import json

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.quality.inspection import ColumnSummary, ScanLines, SurveyMap, time_base
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.reporting import inspection_page
from mlsroad_pipeline.reporting.inspection_page import survey_page
from mlsroad_pipeline.surveys import inspection as inspect_work
from mlsroad_pipeline.surveys.inspection import (
    InspectParameters,
    inspect_file,
    inspect_survey,
    inspection_warnings,
    survey_facts,
)

ORIGIN = np.array([480_000.0, 5_455_000.0, 100.0])


def make_cloud(rng, n=3000):
    xyz = np.round(rng.random((n, 3)) * [40, 20, 8], 3)
    time = np.sort(rng.random(n) * 0.5) + np.where(np.arange(n) < n // 2, 0.0, 30.0)
    columns = {
        **{"classification": np.repeat([1, 2, 65], n // 3).astype(np.uint8), "gps_time": time},
        **{"intensity": np.full(n, 0.5, np.float32), "rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8)},
    }
    return PointCloud(xyz, columns, ORIGIN, parse_crs("EPSG:25832"))


def page_of(survey, files, warnings):
    return survey_page(survey, [file.facts for file in files], {file.name: file.picture for file in files}, warnings)


def write(path, cloud):
    path.parent.mkdir(parents=True, exist_ok=True)
    LasFormat().write(path, cloud, WriteOptions(like="none"))


@pytest.mark.parametrize("chunk", [700, 10_000])
def test_planted_faults_are_found(tmp_path, rng, monkeypatch, chunk):
    monkeypatch.setattr(inspect_work, "CHUNK", chunk)
    cloud = make_cloud(rng)
    doubled = cloud.select(np.concatenate([np.arange(3000), np.arange(40)]))
    write(tmp_path / "a.laz", doubled)
    (tmp_path / "trajectory.csv").write_text("time,x,y,z\n0,0,0,0\n20,10,0,0\n40,20,0,0\n")
    short = tmp_path / "short.csv"
    short.write_text("time,x,y,z\n0,0,0,0\n10,10,0,0\n")
    found = inspect_file(str(tmp_path / "a.laz"), "a.laz", options=ReadOptions(), max_gap=1.0, trajectory=str(short))
    facts, told = found.facts, " | ".join(found.warnings)
    assert facts["n_points"] == 3040 and facts["n_duplicates"] == 40
    assert facts["columns"]["classification"]["counts"] == {"1": 1040, "2": 1000, "65": 1000}
    assert facts["columns"]["intensity"]["minimum"] == facts["columns"]["intensity"]["maximum"]
    world = doubled.world_xyz()
    np.testing.assert_allclose(facts["low"], world.min(axis=0), atol=5e-4)
    np.testing.assert_allclose(facts["high"], world.max(axis=0), atol=5e-4)
    assert facts["time"]["gaps"] == 1 and facts["time"]["longest_gap"] == pytest.approx(30, abs=1)
    assert facts["crs_name"] == "ETRS89 / UTM zone 32N"
    for part in (
        "40 points repeat",
        "1 gaps in gps_time",
        "intensity has a single value",
        "codes above 31",
        "steps back 1 times",
    ):
        assert part in told, part
    assert "the trajectory short.csv covers 0.000 to 10.000 s, the points have" in told
    assert found.picture.counts.sum() == 3040 and found.picture.n_outside == 0
    json.dumps(facts)
    whole = inspect_file(*(str(tmp_path / "a.laz"), "a"), options=ReadOptions(), max_gap=1.0)
    assert "trajectory" not in " ".join(whole.warnings)


def test_a_survey_of_several_files(tmp_path, rng):
    cloud = make_cloud(rng)
    write(tmp_path / "a.laz", cloud)
    write(tmp_path / "b/b.laz", PointCloud(cloud.xyz, {}, ORIGIN, parse_crs("EPSG:25833")))
    (tmp_path / "c.laz").write_bytes((tmp_path / "a.laz").read_bytes()[:-900])
    files, unread = inspect_survey(InspectParameters(), root=str(tmp_path), read={})
    assert [file.name for file in files] == ["a.laz", "b/b.laz"]
    assert list(unread) == ["c.laz"] and "truncated" in unread["c.laz"]
    table = inspection_warnings(files, unread)
    told = table.groupby("file")["warning"].apply(" ".join)
    assert "cannot be read" in told["c.laz"]
    assert (
        "different coordinate reference systems (a.laz: ETRS89 / UTM zone 32N; b/b.laz: ETRS89 / UTM zone 33N)"
        in (told["a.laz"])
    )
    facts = survey_facts(str(tmp_path), files, table)
    assert facts["n_points"] == 6000 and len(facts["warnings"]) == len(table)
    page = page_of("<street>", files, table)
    assert page.count("<img") == 2 and "&lt;street&gt;" in page and "different coordinate reference systems" in page
    with pytest.raises(ParameterError, match=r"inspect\.max_gap"):
        InspectParameters(max_gap=0)
    assert list(inspection_warnings(files[:1], {}).columns) == ["file", "warning"]
    assert page_of("none", [], pd.DataFrame(columns=["file", "warning"])).startswith("<!DOCTYPE")


def test_whole_numbers_give_a_warning(tmp_path, rng):
    path = tmp_path / "a.txt"
    np.savetxt(path, rng.integers(0, 9000, (100, 3)), fmt="%d")
    assert any("whole numbers" in w for w in inspect_file(str(path), "a", options=ReadOptions(), max_gap=1.0).warnings)
    options = ReadOptions(units="millimetre")
    assert not any("whole numbers" in w for w in inspect_file(str(path), "a", options=options, max_gap=1.0).warnings)
    np.savetxt(path, rng.random((100, 3)) * 90)
    found = inspect_file(str(path), "a", options=ReadOptions(), max_gap=1.0)
    assert not any("whole numbers" in w for w in found.warnings)


def test_the_map_against_a_histogram(rng):
    cloud = PointCloud(rng.random((5000, 3)) * [90, 30, 5] + [-20, 4, 0], {}, ORIGIN)
    world = cloud.world_xyz()
    survey = SurveyMap.over(world.min(axis=0), world.max(axis=0), n_cells=50)
    for part in np.array_split(np.arange(5000), 3):
        survey.add(cloud.select(part))
    rows, columns = survey.shape
    edges = [survey.low[1] + np.arange(rows + 1) * survey.cell, survey.low[0] + np.arange(columns + 1) * survey.cell]
    expected = np.histogram2d(world[:, 1], world[:, 0], bins=edges)[0]
    assert (survey.counts != expected).sum() <= 2  # edges, by rounding
    assert survey.counts.sum() == 5000
    assert survey.top.max() == pytest.approx(cloud.xyz[:, 2].max(), rel=1e-6)
    survey.add(PointCloud(np.array([[1e6, 0.0, 0.0]]), {}, ORIGIN))
    assert survey.n_outside == 1
    assert np.nansum(survey.density()) * survey.cell**2 == pytest.approx(5000)


def test_columns_lines_and_times(rng):
    values = rng.normal(size=1000)
    values[[3, 900]] = np.nan, np.inf
    summary = ColumnSummary("float64")
    for part in np.array_split(values, 4):
        summary.add(part, count=False)
    finite = values[np.isfinite(values)]
    assert (summary.minimum, summary.maximum, summary.n_missing) == (finite.min(), finite.max(), 2)
    codes = ColumnSummary("int32", counts={})
    numbers = rng.integers(-3, 100_000, 50).astype(np.int32)
    codes.add(numbers[:20], count=True)
    codes.add(numbers[20:], count=True)
    assert codes.counts == {int(c): int((numbers == c).sum()) for c in np.unique(numbers)}
    codes.add(np.arange(1000, dtype=np.int32), count=True)
    assert codes.counts is None
    angle = np.tile(np.linspace(-40, 40, 100), 6).astype(np.int16)
    lines = ScanLines()
    lines.add(PointCloud(np.zeros((600, 3)), {"scan_angle": angle}))
    assert lines.n_jumps == 5
    assert [time_base(*t)[:8] for t in [(0, 9), (3.5e8, 3.6e8), (1.3e9, 1.3e9), (1.6e9, 1.6e9), (np.nan, 1)]] == [
        *("seconds ", "adjusted", "GPS seco", "seconds ", "none")
    ]


def test_a_warning_of_many_files_is_given_once(tmp_path, rng, monkeypatch):
    monkeypatch.setattr(inspection_page, "MOST_PICTURES", 2)
    for number in range(4):
        columns = {"level": np.zeros(40, np.uint8)} if number == 2 else {}
        write(tmp_path / f"{number:02}.laz", PointCloud(np.round(rng.random((40, 3)), 3), columns, ORIGIN))
    files, unread = inspect_survey(InspectParameters(), root=str(tmp_path), read={})
    table = inspection_warnings(files, unread)
    told = table[table["warning"].str.startswith("no coordinate reference system")]
    assert told["file"].tolist() == ["4 of 4 files, the first 00.laz"]
    assert "only some of the files have level" in table["warning"].tolist()
    assert table["warning"].is_unique
    page = page_of(str(tmp_path), files, table)
    assert "From above: the first 2 of 4 files" in page and page.count("<figure>") == 2
