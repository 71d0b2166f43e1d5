from dataclasses import asdict

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.quality import chunks
from mlsroad_pipeline.algorithms.quality.chunks import STANDARD_COLUMNS, inspect_chunk, merge
from mlsroad_pipeline.algorithms.quality.report import HEADINGS


def survey(rng, n=3000):
    """Points on 10 x 10 m with two duplicates, times with two gaps, and labels."""
    xyz = rng.uniform(0, 10, (n, 3))
    xyz[10], xyz[n - 1] = xyz[n - 2], xyz[0]
    time = np.linspace(100.0, 130.0, n)
    time[n // 3 :] += 5.0
    time[n // 2 :] += 2.5
    columns = {
        "gps_time": time,
        "intensity": rng.random(n).astype(np.float32),
        "label": rng.choice([TAXONOMY["road"], TAXONOMY["car"]], n).astype(np.uint8),
    }
    return PointCloud(xyz, columns, origin=np.array([458_000.0, 5_428_000.0, 100.0]), source="a.laz")


def in_chunks(cloud, size):
    return [inspect_chunk(cloud.select(slice(i, i + size))) for i in range(0, len(cloud), size)]


def test_report_of_a_whole_file_has_the_planted_faults(rng):
    cloud = survey(rng)
    report = merge([inspect_chunk(cloud)])
    assert (report.n_points, report.n_not_finite, report.n_duplicates, report.duplicates_exact) == (3000, 0, 2, True)
    assert (report.n_gaps, report.n_backward) == (2, 0)
    assert report.longest_gap == pytest.approx(5.0 + 30 / 2999)
    assert (report.time_start, report.time_end) == (100.0, pytest.approx(137.5))
    assert report.present == ("intensity", "gps_time", "label")
    assert report.missing == ("rgb", "scanner", "instance")
    road = int((cloud["label"] == TAXONOMY["road"]).sum())
    assert report.classes == {"road": road, "car": 3000 - road}
    np.testing.assert_allclose(report.low, cloud.world_xyz().min(axis=0))
    np.testing.assert_allclose(report.high, cloud.world_xyz().max(axis=0))
    counts = np.unique(np.floor(cloud.world_xyz()[:, :2]), axis=0, return_counts=True)[1]
    assert (report.density, report.median_density) == (3000 / len(counts), np.median(counts))
    assert (report.intensity_min, report.intensity_max) == (cloud["intensity"].min(), cloud["intensity"].max())


@pytest.mark.parametrize("size", [1, 700, 1500, 2999])
def test_any_cutting_into_chunks_gives_the_same_report(rng, size):
    cloud = survey(rng, n=300 if size == 1 else 3000)
    assert asdict(merge(in_chunks(cloud, size))) == asdict(merge([inspect_chunk(cloud)]))


def test_gaps_are_found_in_any_order_and_steps_back_are_counted(rng):
    cloud = survey(rng)
    shuffled = cloud.select(rng.permutation(len(cloud)))
    report = merge(in_chunks(shuffled, 700))
    assert report.n_gaps == 2
    assert report.longest_gap == pytest.approx(5.0 + 30 / 2999)
    assert report.n_backward == np.count_nonzero(np.diff(shuffled["gps_time"]) < 0)


def test_gap_threshold_is_a_parameter(rng):
    cloud = survey(rng)
    assert merge([inspect_chunk(cloud, max_gap=3.0)]).n_gaps == 1
    assert merge([inspect_chunk(cloud, max_gap=6.0)]).n_gaps == 0


def test_not_finite_points_are_counted_and_left_out(rng):
    cloud = survey(rng)
    xyz = cloud.xyz.copy()
    xyz[[5, 7]] = np.nan
    xyz[8, 0] = np.inf
    time = cloud["gps_time"].copy()
    time[:4] = np.nan
    report = merge(in_chunks(PointCloud(xyz, {"gps_time": time}, source="b.laz"), 1000))
    assert (report.n_points, report.n_not_finite, report.n_times_not_finite) == (3000, 3, 4)
    assert np.isfinite([*report.low, *report.high, report.density]).all()
    assert any("3 points with NaN or infinite coordinates" in text for text in report.warnings())
    assert any("4 points with NaN or infinite gps_time" in text for text in report.warnings())


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.full((2, 3), np.nan)])
def test_file_without_usable_points_has_nan_figures(points):
    report = merge([inspect_chunk(PointCloud(points, source="empty.laz"))])
    assert np.isnan([*report.low, *report.high, report.density, report.longest_gap, report.intensity_min]).all()
    assert report.warnings()[0].startswith("empty.laz: ")


def test_large_files_estimate_duplicates_across_chunks(rng, monkeypatch):
    monkeypatch.setattr("mlsroad_pipeline.algorithms.quality.duplicates.SKETCH_SIZE", 2000)
    xyz = rng.random((20_000, 3))
    chunks = [inspect_chunk(PointCloud(part)) for part in (xyz[:15_000], np.concatenate([xyz[15_000:], xyz[:5000]]))]
    report = merge(chunks)
    assert not report.duplicates_exact
    assert report.n_duplicates == pytest.approx(5000, rel=0.15)
    assert merge(chunks[::-1]).n_duplicates == report.n_duplicates


def test_sketches_with_the_size_of_the_file_stay_small_and_estimate_the_same(rng, monkeypatch):
    monkeypatch.setattr("mlsroad_pipeline.algorithms.quality.duplicates.SKETCH_SIZE", 2000)
    xyz = rng.random((40_000, 3))
    xyz = np.concatenate([xyz, xyz[:10_000]])
    parts = [PointCloud(xyz[i : i + 5000]) for i in range(0, len(xyz), 5000)]
    whole = merge([inspect_chunk(part) for part in parts])
    chunks = [inspect_chunk(part, n_total=len(xyz)) for part in parts]
    assert sum(len(chunk.sketch.hashes) for chunk in chunks) < 1.3 * 2 * 2000
    report = merge(chunks)
    assert not report.duplicates_exact
    assert report.n_duplicates == whole.n_duplicates == pytest.approx(10_000, rel=0.1)


def test_estimate_of_a_large_file_full_of_copies_uses_the_covered_share(rng, monkeypatch):
    monkeypatch.setattr("mlsroad_pipeline.algorithms.quality.duplicates.SKETCH_SIZE", 400)
    part = PointCloud(rng.random((1000, 3)))
    report = merge([inspect_chunk(part, n_total=8000) for _ in range(8)])
    assert report.n_duplicates == pytest.approx(7000, rel=0.25)


def test_sketch_of_a_file_full_of_copies_still_counts(rng, monkeypatch):
    monkeypatch.setattr("mlsroad_pipeline.algorithms.quality.duplicates.SKETCH_SIZE", 100)
    chunk = inspect_chunk(PointCloud(np.repeat(rng.random((50, 3)), 400, axis=0)))
    assert chunk.n_duplicates == 50 * 399
    assert chunk.sketch.complete
    assert merge([chunk, chunk]).n_duplicates == 50 * 799


def test_zero_and_minus_zero_are_one_place():
    assert merge([inspect_chunk(PointCloud(np.array([[0.0, 0.0, 0.0], [-0.0, 0.0, -0.0]])))]).n_duplicates == 1


def test_row_is_flat_and_complete(rng):
    row = merge(in_chunks(survey(rng), 1000)).as_row()
    assert all(isinstance(value, str | bool | int | float) for value in row.values())
    assert {"source", "min_x", "max_z", "density", "n_gaps", "class_road", "class_car"} <= set(row)
    assert [row[f"has_{name}"] for name in STANDARD_COLUMNS] == [False, True, True, False, True, False]
    assert {name for name in row if not name.startswith("class_")} == set(HEADINGS)  # a report has words for all


def test_warnings_name_the_file_and_are_silent_when_all_is_well(rng):
    texts = merge([inspect_chunk(survey(rng))]).warnings()
    assert all(text.startswith("a.laz: ") for text in texts)
    assert any("2 points repeat another" in text for text in texts)
    assert any("2 gaps in gps_time over 1 s, up to 5.01 s" in text for text in texts)
    assert any("no column rgb:" in text for text in texts)
    full = {name: np.zeros(1, dtype=np.uint8) for name in STANDARD_COLUMNS}
    assert merge([inspect_chunk(PointCloud(np.zeros((1, 3)), full))]).warnings() == []


def test_codes_outside_the_taxonomy_are_named():
    report = merge([inspect_chunk(PointCloud(np.zeros((2, 3)), {"label": np.array([1, 199], dtype=np.int16)}))])
    assert report.classes == {"road": 1, "unknown_199": 1}
    assert any("unknown_199" in text for text in report.warnings())


def test_bad_calls_are_named():
    cloud = PointCloud(np.zeros((1, 3)))
    with pytest.raises(ParameterError, match=r"max_gap .*got 0"):
        inspect_chunk(cloud, max_gap=0)
    with pytest.raises(DataError, match="no chunks"):
        merge([])
    with pytest.raises(DataError, match=r"different max_gap: \[1.0, 2.0\]"):
        merge([inspect_chunk(cloud), inspect_chunk(cloud, max_gap=2.0)])


def test_occupied_cells_are_those_of_floor(rng):
    world = np.concatenate(
        [rng.normal(0.0, 5.0, (500, 3)), np.repeat(rng.normal(0.0, 5.0, (20, 3)), 30, axis=0), np.zeros((1, 3))]
    )
    world[:3, :2] = [[-1.0, 2.0], [1e300, -1e300], [-1e19, 1e19]]
    keys, counts = chunks._occupied_cells(world)
    with np.errstate(invalid="ignore"):
        cells = np.floor(world[:, :2]).astype(np.int64)
    expected = np.unique((cells[:, 0] << 32) + cells[:, 1], return_counts=True)
    np.testing.assert_array_equal(keys, expected[0])
    np.testing.assert_array_equal(counts, expected[1])
