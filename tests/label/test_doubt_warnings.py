"""Warnings and table of doubtful clusters, from the scenes to the report."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.objects.doubts import VEHICLE_SIZED
from mlsroad_pipeline.label.checks import _check_degrees
from mlsroad_pipeline.label.result_warnings import doubt_warnings
from mlsroad_pipeline.label.scene import scene_doubts

SCHEME = ClassScheme("own", ("paved ground", "low vegetation"), (("road",), ("bush",)), (), (11, 3))


def test_a_scene_lists_the_doubtful_clusters_of_its_core_in_world_coordinates(rng):
    road = rng.uniform([0, 0, 0], [40, 20, 0.05], (20_000, 3))
    cars = [rng.uniform([x, 8, 0.1], [x + 4, 9.8, 1.5], (3000, 3)) for x in (5, 30)]
    xyz = np.concatenate([road, *cars])
    label = np.repeat([0, 1], [20_000, 6000])
    origin = np.array([500.0, 900.0, 10.0])
    scene = PointCloud(xyz, {"core": xyz[:, 0] < 25}, origin)
    table = scene_doubts(scene, label, xyz[:, 2].astype(np.float32), SCHEME)
    assert table["reason"].tolist() == [VEHICLE_SIZED] and table["points"].item() == 3000
    np.testing.assert_allclose(table[["x", "y", "z"]].to_numpy()[0], [507, 908.9, 10.8], atol=0.15)
    (warning,) = doubt_warnings(table)
    assert warning.startswith(f"1 cluster with 3,000 points may have a wrong class: {VEHICLE_SIZED} (1).")
    assert doubt_warnings(table[:0]) == []


def test_one_warning_counts_the_clusters_of_each_reason_those_with_most_points_first():
    table = pd.DataFrame({"reason": ["a", "b", "b"], "points": [500, 2000, 3000]})
    (warning,) = doubt_warnings(table)
    assert warning.startswith("3 clusters with 5,500 points may have a wrong class: b (2); a (1).")


def test_the_message_about_degrees_has_a_command_for_both_orders():
    row = {"min_x": 52.5155, "min_y": 13.3700, "min_z": 30.0, "max_x": 52.5160, "max_y": 13.3710, "max_z": 60.0}
    with pytest.raises(DataError) as error:
        _check_degrees(row, "a b.txt")
    text = str(error.value)
    assert "mlsroad label 'a b.txt' --crs EPSG:4326 --params label.read.reproject=EPSG:32639;" in text
    assert text.count("EPSG:32633") == 1 and "--params label.read.columns.x=1 --params label.read.columns.y=0" in text
