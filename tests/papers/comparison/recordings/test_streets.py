"""Scenes of simulated streets for the benchmark of recordings."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.comparison.recordings.streets import ignoring, make_scenes, scenes_in
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

XYZ = np.zeros((4, 3))


def test_ignored_rows_are_unlabelled_in_a_copy():
    cloud = PointCloud(XYZ, {"label": np.full(4, TAXONOMY["road"], np.uint8)})
    changed = ignoring(cloud, np.array([True, False, False, True]))
    assert changed["label"].tolist() == [0, TAXONOMY["road"], TAXONOMY["road"], 0]
    assert (cloud["label"] == TAXONOMY["road"]).all()
    assert list(scenes_in(cloud)) == ["scene_000"]


def test_street_gives_one_revolution_per_spacing():
    bare = dict.fromkeys(("trees", "shrubs", "palms", "cycas", "clutter", "people", "traffic"), 0.0)
    survey = {"preset": "hdl64", "seed": 3, "length": 10, "speed": 20, "pulse_rate": 40_000, "with_images": False}
    simulation = simulation_parameters({**survey, "street": bare})
    scans = make_scenes(simulation=simulation, scan_spacing=5.0)
    whole = make_scenes(simulation=simulation, scan_spacing=None)
    assert list(scans) == ["scene_000", "scene_001"]
    assert list(whole) == ["scene_000"]
    share = [len(scan) / len(whole["scene_000"]) for scan in scans.values()]
    assert share == pytest.approx([0.2, 0.2], abs=0.05)  # 0.1 s of 0.5 s
    assert sorted(scans["scene_001"].columns) == ["intensity", "label"]
