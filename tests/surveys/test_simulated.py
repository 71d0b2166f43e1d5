"""Simulated surveys on disk, and their progress in the log or from a worker process."""

import json
import logging

import laspy
import numpy as np
import pandas as pd
import pytest
from PIL import Image as Picture
from references.simulator import brown_conrady

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.pipelines.simulate import simulate_surveys
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.furnishing.blocks import PASS_INSTANCES
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.simulation.street.drive import PAUSE
from mlsroad_pipeline.surveys import simulated
from mlsroad_pipeline.surveys.simulated import (
    SurveyFiles,
    configured_survey,
    write_simulated_survey,
)
from mlsroad_pipeline.surveys.simulated_scans import RangeImage, semantic_kitti_codes

CONFIG = {
    "preset": "hdl64", "seed": 3, "length": 10.0, "speed": 8.0, "pulse_rate": 15_000.0, "max_range": 40.0,
    "with_images": True, "image_width": 96, "image_height": 72, "image_interval": 5.0, "image_readout": 0.0,
    "trajectory_noise": 0.0, "boresight_error": 0.0, "pass_offset": 0.25, "passes": 2, "piece_length": 4.0,
    "frames": True,
}  # fmt: skip


@pytest.fixture(scope="module")
def parameters():
    return simulation_parameters(CONFIG)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, parameters):
    target = tmp_path_factory.mktemp("simulated") / "survey"
    counts = write_simulated_survey(
        parameters=parameters, folder=str(target), n_threads=2, files=configured_survey(CONFIG)[1]
    )
    assert int(counts["n_images"]) == 2 * 2 * 3
    return target


@pytest.fixture(scope="module")
def survey(parameters):
    return simulate_survey(parameters)


@pytest.fixture(scope="module")
def clouds(folder):
    return [laspy.read(folder / f"survey_{k:03d}.laz") for k in range(6)]


def test_files_hold_the_survey_point_by_point(folder, clouds, survey):
    assert {path.name for path in folder.glob("*.laz")} == {f"survey_{k:03d}.laz" for k in range(6)}
    xyz = np.concatenate([las.xyz for las in clouds])
    assert len(xyz) == len(survey.cloud) > 2000
    np.testing.assert_allclose(xyz, survey.cloud.world_xyz(), atol=0.0006)
    for name, column in (("gps_time", "gps_time"), ("label", "label"), ("instance", "instance")):
        np.testing.assert_array_equal(np.concatenate([las[name] for las in clouds]), survey.cloud[column])
    assert clouds[0].header.parse_crs().to_epsg() == 25833


def test_pieces_are_cut_along_the_street_and_by_pass(clouds, folder):
    trajectory = pd.read_csv(folder / "trajectory.csv")
    local = trajectory[["x", "y"]].to_numpy()
    first = trajectory["gps_time"] < trajectory["gps_time"][0] + 60
    station = np.concatenate(
        [np.cumsum(np.r_[0, np.hypot(*np.diff(local[rows], axis=0).T)]) for rows in (first, ~first)]
    )
    for k, las in enumerate(clouds):
        at = np.interp(las.gps_time, trajectory["gps_time"], station)
        assert at.min() > 4 * (k % 3) - 0.1 and at.max() < min(4 * (k % 3) + 4, 10) + 0.1
    gap = clouds[3].gps_time.min() - clouds[2].gps_time.max()
    assert PAUSE - 0.2 < gap < PAUSE + 0.3


def test_the_second_pass_is_off_by_its_offset_and_meets_others(survey):
    cloud, street = survey.cloud, survey.street
    road = (cloud["label"] == TAXONOMY["road"]) & (cloud["return_number"] == 1)
    second = cloud["gps_time"] > cloud["gps_time"][0] + 60
    gaps = []
    for rows in (road & ~second, road & second):
        xyz = cloud.xyz[rows].astype(float)
        gaps.append(np.median(xyz[:, 2] - street.ground.height(*street.alignment.locate(xyz[:, :2]))))
    assert abs(gaps[0]) < 0.02
    table = survey.trajectory
    passes = [
        table[table["gps_time"] < table["gps_time"][0] + 60],
        table[table["gps_time"] > table["gps_time"][0] + 60],
    ]
    # Both passes keep to one lane; the vehicle's height above the road differs by the offset and its springs.
    heights = []
    for part in passes:
        local = part[["x", "y", "z"]].to_numpy() - survey.origin
        heights.append(np.median(local[:, 2] - street.ground.height(*street.alignment.locate(local[:, :2]))))
    assert gaps[1] - gaps[0] == pytest.approx(heights[1] - heights[0], abs=0.025)
    moving = survey.objects[survey.objects["moving"]]["instance"]
    seen_again = set(cloud["instance"][second].tolist()) & set(moving)
    assert all(number >= PASS_INSTANCES for number in seen_again)
    assert not any(number >= PASS_INSTANCES for number in set(cloud["instance"][~second].tolist()))
    assert survey.objects["instance"].is_unique


def test_calibration_and_truth_images_fit_the_points(folder, clouds):
    calibration = json.loads((folder / "calibration.json").read_text())
    las = clouds[0]
    moving = pd.read_csv(folder / "objects.csv").query("moving")["instance"].to_numpy()
    fixed = ~np.isin(las["instance"], moving)
    xyz = (las.xyz - calibration["origin"])[fixed]
    labels, instances = np.asarray(las["label"])[fixed], np.asarray(las["instance"])[fixed]
    right = total = same = 0
    for view in calibration["images"][:3]:
        label = np.array(Picture.open(folder / "labels" / f"{view['name']}.png"))
        index = np.array(Picture.open(folder / "instances" / f"{view['name']}.png"))
        assert label.dtype == index.dtype == np.uint16 and label.shape == (72, 96)
        assert index.max() == len(view["instances"])
        table = np.array([0, *view["instances"]])
        seen = xyz @ np.array(view["R"]).T + view["t"]
        nearest, found = {}, []
        for p, c, number in zip(seen, labels, instances, strict=True):
            if p[2] < 0.5 or np.abs(p[:2]).max() > p[2]:
                continue
            bent = brown_conrady(p[0] / p[2], p[1] / p[2], view["distortion"])
            u, v, _ = np.floor(np.array(view["K"]) @ [*bent, 1.0] + 0.5).astype(int)
            if 0 <= u < 96 and 0 <= v < 72:
                cell = u // 3, v // 3
                nearest[cell] = min(nearest.get(cell, np.inf), p[2])
                found.append((cell, p[2], label[v, u] == c, table[index[v, u]] == number))
        # What lies behind the nearest point around may be hidden from the camera, which is not where the scanner is.
        for cell, z, same_label, same_instance in found:
            if z < 1.05 * nearest[cell]:
                total, right, same = total + 1, right + same_label, same + same_instance
    assert total > 200
    assert right / total > 0.75 and same / total > 0.8


def test_frames_are_revolutions_in_the_scanners_axes(folder, clouds, parameters):
    scans = sorted((folder / "frames" / "velodyne").glob("*.bin"))
    poses = np.loadtxt(folder / "frames" / "poses.txt").reshape(-1, 3, 4)
    assert len(scans) == len(poses) == len(list((folder / "frames" / "labels").glob("*.label")))
    points = [np.fromfile(path, "<f4").reshape(-1, 4) for path in scans]
    origin = [parameters.easting, parameters.northing, parameters.height]
    world = np.concatenate([p[:, :3] @ pose[:, :3].T + pose[:, 3] for p, pose in zip(points, poses, strict=True)])
    np.testing.assert_allclose(world + origin, np.concatenate([las.xyz for las in clouds]), atol=0.002)
    truth = np.concatenate([las["label"] for las in clouds])
    codes = np.concatenate([np.fromfile(path, "<u4") for path in sorted((folder / "frames" / "labels").iterdir())])
    still = (codes & 0xFFFF) < 252
    np.testing.assert_array_equal((codes & 0xFFFF)[still], semantic_kitti_codes()[truth][still])
    instance = np.concatenate([las["instance"] for las in clouds])
    assert len({*zip(codes >> 16, instance, strict=True)}) == len(np.unique(instance))
    # The ground lies under the scanner by its height on the car.
    ground = (codes[: len(points[0])] & 0xFFFF) == 40
    near = np.hypot(*points[0][:, :2].T) < 6
    assert np.median(points[0][ground & near, 2]) == pytest.approx(-1.73, abs=0.08)
    assert points[0][:, 3].min() >= 0 and points[0][:, 3].max() <= 1


def test_scan_spacing_scans_one_revolution_of_each_piece_of_street(tmp_path, clouds):
    config = {**CONFIG, "with_images": False, "scan_spacing": 4.0}
    del config["piece_length"], config["frames"]
    parameters, files = configured_survey(config)
    write_simulated_survey(parameters=parameters, folder=str(tmp_path / "scans"), n_threads=2, files=files)
    scans = [laspy.read(tmp_path / "scans" / name) for name in files.names(parameters)]
    assert len(scans) == len(clouds) == 6
    for scan, piece in zip(scans, clouds, strict=True):  # the pieces of the same survey
        begin = np.asarray(piece.gps_time).min()
        pulses = np.asarray(piece.gps_time)
        pulses = pulses[pulses < begin + 0.1]
        assert scan.gps_time.min() > begin - 0.005 and np.ptp(scan.gps_time) < 0.1
        # The same pulses into the same street; only their noise differs.
        assert len(np.intersect1d(scan.gps_time, pulses)) > 0.9 * max(len(pulses), len(scan.points))
    with pytest.raises(ParameterError, match="piece_length and scan_spacing exclude each other"):
        configured_survey({**config, "piece_length": 4.0})


def test_scans_of_several_revolutions_are_thinned_to_range_images(tmp_path):
    config = {
        "preset": "hdl64", "seed": 3, "length": 12.0, "speed": 20.0, "pulse_rate": 60_000.0, "scan_spacing": 6.0,
        "revolutions": 2, "trajectory_noise": 0.0, "boresight_error": 0.0,
        "range_image": {"rows": 32, "columns": 128},
    }  # fmt: skip
    whole = {name: value for name, value in config.items() if name != "range_image"}
    sizes = {}
    for name, one in (("thin", config), ("whole", whole)):
        parameters, files = configured_survey(one)
        write_simulated_survey(parameters=parameters, folder=str(tmp_path / name), n_threads=1, files=files)
        scans = [laspy.read(tmp_path / name / file) for file in files.names(parameters)]
        assert [0.15 < np.ptp(scan.gps_time) < 0.2 for scan in scans] == [True, True]
        sizes[name] = [len(scan.points) for scan in scans]
    assert max(sizes["thin"]) <= 32 * 128 < min(sizes["whole"])
    image = RangeImage(rows=2, columns=4, top=10.0, bottom=-10.0)
    ahead = np.array([[5.0, 0.1, 0.5], [9.0, 0.3, 0.2], [5.0, 0.1, -0.5], [-5.0, 0.1, 3.0]])
    assert image.kept(ahead).tolist() == [1, 2, 3]
    with pytest.raises(ParameterError, match="range_image needs scan_spacing"):
        SurveyFiles(range_image=image)
    with pytest.raises(ParameterError, match="unknown or missing: row, rows"):
        configured_survey({**config, "range_image": {"row": 2, "columns": 3}})


def test_every_taxonomy_class_has_a_semantic_kitti_code():
    table = semantic_kitti_codes()
    assert table[TAXONOMY["car"]] == 10 and table[TAXONOMY["bin"]] == 99 and table[0] == 0
    assert all(table[code] for code in TAXONOMY.values() if code)


def test_one_survey_alone_and_its_files_are_announced(tmp_path):
    class Roots:
        root = tmp_path

    surveys = {"a": {"preset": "tiny", "piece_length": 12}, "b": {"preset": "tiny"}, "c": None}
    tasks = simulate_surveys({"enabled": True, "only": None, "surveys": surveys}, Roots)
    assert set(tasks) == {"a", "b"}
    assert [path.rsplit("/")[-1] for path in tasks["a"].outputs] == [
        "survey_000.laz", "survey_001.laz", "survey_002.laz", "trajectory.csv",
    ]  # fmt: skip
    assert set(simulate_surveys({"enabled": True, "only": "b", "surveys": surveys}, Roots)) == {"b"}
    with pytest.raises(ParameterError, match=r"unknown simulation.only 'x'"):
        simulate_surveys({"enabled": True, "only": "x", "surveys": surveys}, Roots)


def test_bad_layouts_are_named(tmp_path):
    with pytest.raises(ParameterError, match=r"piece_length .*got -1"):
        SurveyFiles(piece_length=-1)
    with pytest.raises(ParameterError, match="unknown simulation parameters: peice_length"):
        simulation_parameters({"peice_length": 3})
    tiny = simulation_parameters({"preset": "tiny"})
    with pytest.raises(ParameterError, match="frames need a scanner with an upright axis, 'vmx450' has none"):
        write_simulated_survey(parameters=tiny, folder=str(tmp_path / "x"), n_threads=1, files=SurveyFiles(frames=True))


def test_simulated_distance_is_reported_in_the_log_and_from_a_worker(monkeypatch, caplog, capsys):
    times = iter([0.0, 1.0, 20.0, 21.0, 40.0, 60.0])
    monkeypatch.setattr(simulated.time, "monotonic", lambda: next(times))
    caplog.set_level(logging.INFO, "mlsroad_pipeline")
    report = simulated.distance_lines("avenue", 100.0)
    for distance in (5.0, 25.0, 26.0, 50.0, 100.0):
        report(distance)
    assert [r.getMessage() for r in caplog.records] == [
        "avenue: 25 of 100 m, about 60 s left",
        "avenue: 50 of 100 m, about 40 s left",
    ]
    times = iter([0.0, 20.0])
    caplog.set_level(logging.WARNING, "mlsroad_pipeline")
    simulated.distance_lines("avenue", 100.0)(50.0)
    assert capsys.readouterr().err == "avenue: 50 of 100 m, about 20 s left\n"
