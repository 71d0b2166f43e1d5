from dataclasses import replace

import numpy as np
import pyproj
import pytest
from references.simulator import GROUND_LABELS

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.simulation import (
    PRESETS,
    SCANNERS,
    SimulationParameters,
    SurveyStream,
    long_survey,
    simulate_survey,
    stream_points,
)
from mlsroad_pipeline.simulation.runtime import worker_pool

COLUMNS = {
    "rgb": np.uint8, "intensity": np.float32, "gps_time": np.float64, "scanner": np.uint8, "label": np.uint8,
    "instance": np.int32, "return_number": np.uint8, "number_of_returns": np.uint8, "scan_angle": np.float32,
}  # fmt: skip


def test_a_survey_has_what_a_real_one_delivers(survey, parameters):
    cloud = survey.cloud
    assert 20_000 < len(cloud) < 45_000
    assert {name: values.dtype for name, values in cloud.columns.items()} == {
        k: np.dtype(v) for k, v in COLUMNS.items()
    }
    assert cloud.xyz.dtype == np.float32 and np.isfinite(cloud.xyz).all()
    assert (np.diff(cloud["gps_time"]) >= 0).all()
    assert set(np.unique(cloud["scanner"])) == {0, 1}
    assert cloud["intensity"].min() >= 0 and cloud["intensity"].max() <= 1
    assert (cloud["return_number"] <= cloud["number_of_returns"]).all() and cloud["return_number"].min() == 1
    assert np.abs(cloud["scan_angle"]).max() <= 180
    assert (cloud.origin == [parameters.easting, parameters.northing, parameters.height]).all()
    assert pyproj.CRS.from_wkt(cloud.crs).to_epsg() == 25833
    trajectory = survey.trajectory
    assert list(trajectory.columns) == ["gps_time", "x", "y", "z", "roll", "pitch", "heading"]
    assert trajectory["gps_time"].iloc[0] <= cloud["gps_time"][0]
    assert trajectory["gps_time"].iloc[-1] >= cloud["gps_time"][-1] - 0.01
    step = np.hypot(trajectory["x"].diff(), trajectory["y"].diff()).sum()
    assert step == pytest.approx(parameters.length, rel=0.03)


def test_the_same_bytes_from_any_number_of_processes(survey, parameters, monkeypatch):
    monkeypatch.setattr(worker_pool, "_MIN_WORK", 0)
    other = simulate_survey(parameters, n_threads=2)
    assert other.cloud.xyz.tobytes() == survey.cloud.xyz.tobytes()
    for name in COLUMNS:
        assert other.cloud[name].tobytes() == survey.cloud[name].tobytes(), name
    for a, b in zip(survey.images, other.images, strict=True):
        assert a.rgb.tobytes() == b.rgb.tobytes() and a.label.tobytes() == b.label.tobytes() and a.name == b.name
    assert other.trajectory.equals(survey.trajectory) and other.objects.equals(survey.objects)
    # Another process returns the same block and points, passes errors on, and its end is an error.
    [process] = worker_pool._IDLE
    stream = SurveyStream(parameters)
    survey_id = ("other", (parameters, stream.length, 0, stream.drive.start), 0)
    blocks = {k: process.submit(*survey_id, "build", k, {}).result() for k in stream.near(0)}
    here = stream.build(0)
    for name in ("vertices", "faces", "attributes", "instances", "centre", "box"):
        np.testing.assert_array_equal(getattr(blocks[0].soup, name), getattr(here.soup, name))
    part = process.submit(*survey_id, "scan", stream.spans(0)[0], blocks).result()
    np.testing.assert_array_equal(part.xyz.astype(np.float32), survey.cloud.xyz[: len(part)])
    with pytest.raises(TypeError):
        process.submit(*survey_id, "build", "x", {}).result()
    process.process.terminate()
    with pytest.raises(DataError, match="a process that simulated a part of the survey ended"):
        process.submit(*survey_id, "build", 0, {}).result()


@pytest.fixture(scope="module")
def elsewhere(parameters):
    """The same survey far in the north-east, without images."""
    return simulate_survey(replace(parameters, easting=799_999.123, northing=9_999_999.456, with_images=False))


def test_another_seed_is_another_survey(survey, parameters):
    others = list(stream_points(long_survey(replace(parameters, seed=6), n_points=1000), n_points=1000))
    assert not np.allclose(others[0].world_xyz(), survey.cloud.world_xyz()[:1000], atol=0.5)


def test_utm_offsets_keep_millimetres_and_images_move_no_point(elsewhere, survey):
    shift = elsewhere.cloud.world_xyz() - survey.cloud.world_xyz()
    np.testing.assert_allclose(shift, np.broadcast_to(elsewhere.origin - survey.origin, shift.shape), atol=1e-6)


def test_many_classes_in_street_like_shares(survey):
    codes, counts = np.unique(survey.cloud["label"], return_counts=True)
    names = {TAXONOMY_NAMES[int(code)] for code in codes}
    assert len(names) >= 20
    assert {"road", "lane_marking", "sidewalk", "curb", "building", "tree", "palm"} <= names
    ground = np.isin(codes, GROUND_LABELS)
    assert 0.35 < counts[ground].sum() / counts.sum() < 0.75


def test_no_class_gives_itself_away_by_one_colour_or_intensity(survey):
    cloud = survey.cloud
    for code in np.unique(cloud["label"]):
        chosen = cloud["label"] == code
        if chosen.sum() < 50:
            continue
        others = cloud["intensity"][~chosen]
        low, high = np.quantile(cloud["intensity"][chosen], [0.05, 0.95])
        assert high - low > 0.01, TAXONOMY_NAMES[int(code)]
        assert np.mean((others >= low) & (others <= high)) > 0.001, TAXONOMY_NAMES[int(code)]
        assert cloud["rgb"][chosen].std() > 2, TAXONOMY_NAMES[int(code)]


def test_ground_points_lie_on_the_streets_surface(survey):
    cloud = survey.cloud
    ground = np.isin(cloud["label"], GROUND_LABELS)
    xyz = cloud.xyz[ground].astype(np.float64)
    station, offset = survey.street.alignment.locate(xyz[:, :2])
    gap = xyz[:, 2] - survey.street.ground.height(station, offset)
    grass = cloud["label"][ground] == TAXONOMY["grass"]
    assert np.quantile(np.abs(gap[~grass]), 0.98) < 0.05
    assert np.quantile(gap[grass], 0.99) < 0.15
    # The surface is not a plane.
    plane = np.column_stack([xyz[:, :2], np.ones(len(xyz))])
    residual = xyz[:, 2] - plane @ np.linalg.lstsq(plane, xyz[:, 2], rcond=None)[0]
    assert residual.std() > 0.03


def test_the_truth_table_agrees_with_the_points(survey):
    cloud, table = survey.cloud, survey.objects
    assert table["instance"].is_unique and (table["instance"] > 0).all()
    assert set(np.unique(cloud["instance"])) - {0} == set(table["instance"])
    checked = 0
    for row in table[~table["moving"]].itertuples():
        points = cloud.xyz[cloud["instance"] == row.instance].astype(np.float64) + survey.origin
        # Range noise, mixed pixels and the trajectory cause errors of some centimetres.
        c, s = np.cos(row.heading), np.sin(row.heading)
        east, north = points[:, 0] - row.box_x, points[:, 1] - row.box_y
        along, across, up = c * east + s * north, c * north - s * east, points[:, 2] - row.z
        inside = (np.abs(along) < row.length / 2 + 0.15) & (np.abs(across) < row.width / 2 + 0.15)
        if row.label == TAXONOMY["wire"]:
            continue
        assert np.mean(inside & (up < row.height + 0.15)) > 0.9, row
        assert np.mean(up > -0.45) > 0.95, row
        checked += 1
    assert checked > 30
    ground = survey.street.ground
    local = table[["x", "y", "z"]].to_numpy() - survey.origin
    standing = ~table["label"].isin([TAXONOMY["wire"]]).to_numpy()
    height = ground.height(*survey.street.alignment.locate(local[standing, :2]))
    np.testing.assert_allclose(local[standing, 2], height, atol=0.01)
    linear = [TAXONOMY[k] for k in ("building", "wall", "fence", "hedge")]
    assert not cloud["instance"][np.isin(cloud["label"], linear + GROUND_LABELS)].any()


def test_without_images_points_still_have_colour(elsewhere):
    assert elsewhere.images == []
    rgb = elsewhere.cloud["rgb"].astype(float)
    assert (rgb.sum(axis=1) > 0).mean() > 0.99
    grass, road = (rgb[elsewhere.cloud["label"] == TAXONOMY[k]].mean(axis=0) for k in ("grass", "road"))
    assert grass[1] - grass[0] > road[1] - road[0] + 10


def test_chunks_follow_each_other_to_the_exact_count(parameters):
    fast = replace(parameters, pulse_rate=8_000.0, speed=30.0)
    stream = long_survey(fast, n_points=35_001)
    chunks = list(stream_points(stream, n_points=35_001))
    assert sum(len(c) for c in chunks) == 35_001
    times = np.concatenate([c["gps_time"] for c in chunks])
    assert (np.diff(times) >= 0).all()
    assert len({tuple(c.origin) for c in chunks}) == len(chunks) > 1
    assert max(np.abs(c.xyz).max() for c in chunks) < 200
    assert set(chunks[0].columns) == set(COLUMNS)
    ends = [c.world_xyz().mean(axis=0) for c in chunks]
    assert np.linalg.norm(ends[-1] - ends[0]) > 40
    first, last = stream.trajectory["gps_time"].iloc[[0, -1]]
    assert first <= times[0] and times[-1] <= last


def test_a_stream_yields_the_points_of_the_whole_survey(survey, stream, scene):
    pieces = [stream.scan_span(scene, *span) for span in stream.spans(0)]
    np.testing.assert_array_equal(np.concatenate([p.xyz for p in pieces]).astype(np.float32), survey.cloud.xyz)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed must be an integer >= 0, got -1"),
        ({"seed": 1.5}, "seed must be an integer"),
        ({"seed": "first"}, "seed must be an integer >= 0, got 'first'"),
        ({"length": "many"}, "length must be between 10 and 5000 m, got 'many'"),
        ({"length": 5.0}, "length must be between 10 and 5000 m, got 5.0"),
        ({"length": float("nan")}, "length must be between"),
        ({"speed": 0.0}, "speed must be a finite number > 0, got 0.0"),
        ({"pulse_rate": float("inf")}, "pulse_rate must be a finite number > 0, got inf"),
        ({"pulse_rate": 100.0}, "pulse_rate must be at least 16 pulses per profile, got 100.0"),
        ({"profile_rate": -3.0}, "profile_rate must be a finite number > 0"),
        ({"range_noise": -0.1}, "range_noise must be between 0 and 100, got -0.1"),
        ({"trajectory_noise": float("nan")}, "trajectory_noise must be between"),
        ({"beam_divergence": 0.0}, "beam_divergence must be a finite number > 0"),
        ({"max_range": -1.0}, "max_range must be a finite number > 0"),
        ({"image_width": 8}, "image_width must be between 16 and 8192 pixels, got 8"),
        ({"image_interval": 0.0}, "image_interval must be a finite number > 0"),
        ({"easting": 1e12}, "easting must be between"),
        ({"height": float("nan")}, "height must be between"),
        ({"start_time": -1.0}, "start_time must be between"),
        ({"epsg": 4326}, "epsg 4326 must be a projected system in metres"),
        ({"epsg": 999999}, "epsg 999999 is not a known coordinate reference system"),
        ({"epsg": 2272}, "epsg 2272 must be a projected system in metres"),
    ],
)
def test_bad_parameters_are_named(change, message):
    with pytest.raises(ParameterError, match=message):
        replace(SimulationParameters(), **change)


def test_bad_counts_are_named(parameters):
    with pytest.raises(ParameterError, match="n_points must be >= 1, got 0"):
        next(stream_points(long_survey(parameters, n_points=1), n_points=0))
    with pytest.raises(ParameterError, match="n_threads must be >= 1, got 0"):
        simulate_survey(parameters, n_threads=0)


def test_presets_are_what_they_say():
    assert set(PRESETS) == {"tiny", "small", "demo", *SCANNERS}
    assert PRESETS["demo"] == SimulationParameters()
