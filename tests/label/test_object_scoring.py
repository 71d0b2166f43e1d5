"""Scores of an inventory: objects whose points belong to an object that does not count."""

import numpy as np
import pandas as pd
import pytest
from helpers.inventories import planted_inventory

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.inventory_files.geoparquet import write_geoparquet
from mlsroad_pipeline.label.object_scoring import ScoreParameters, score_inventory

CAR = {
    "label": TAXONOMY["car"], "z": 34.0, "design": "sedan", "length": 4.5, "width": 1.9, "height": 1.5, "heading": 0.0,
    "panel_x": np.nan, "panel_y": np.nan, "panel_azimuth": np.nan,
}  # fmt: skip


def scored(tmp_path, moving):
    """Score an inventory whose vehicle lies 20 m from the place of the car that its points belong to."""
    inventory = planted_inventory()
    write_geoparquet(inventory, tmp_path / "inventory.parquet")
    vehicle = inventory.objects[inventory.objects["kind"] == "vehicle"].iloc[0]
    place = {"x": vehicle["x"] + 20.0, "y": vehicle["y"], "box_x": vehicle["x"] + 20.0, "box_y": vehicle["y"]}
    pd.DataFrame([{**CAR, **place, "instance": 7, "moving": moving}]).to_csv(tmp_path / "objects.csv", index=False)
    number = int(vehicle["object_id"])
    columns = {
        "object_id": np.array([number] * 90 + [0] * 10, np.uint32),
        "instance": np.array([7] * 60 + [0] * 40, np.int32),
    }
    xyz = np.random.default_rng(0).random((100, 3)) + [vehicle["x"], vehicle["y"], 34.0]
    LasFormat().write(tmp_path / "street.laz", PointCloud(xyz - xyz[0], columns, xyz[0]), WriteOptions(like="none"))
    found = score_inventory(ScoreParameters(str(tmp_path), str(tmp_path))).matched.objects
    return found.loc[found["kind"] == "vehicle", "outcome"].item()


def test_a_listed_piece_of_a_moving_car_is_ignored_wherever_it_was_scanned(tmp_path):
    assert scored(tmp_path, moving=True) == "ignored"


def test_a_listed_piece_of_a_standing_car_is_false_far_from_its_place(tmp_path):
    assert scored(tmp_path, moving=False) == "false"


@pytest.mark.parametrize(("shift", "warned"), [(60.0, False), (50_000.0, True)])
def test_a_truth_in_another_place_is_a_warning(tmp_path, caplog, shift, warned):
    inventory = planted_inventory()
    write_geoparquet(inventory, tmp_path / "inventory.parquet")
    truth = inventory.objects[["kind", "x", "y"]]
    truth.assign(x=truth["x"] + shift).to_csv(tmp_path / "truth.csv", index=False)
    score_inventory(ScoreParameters(str(tmp_path), str(tmp_path / "truth.csv")))
    assert ("m from those of the inventory" in caplog.text) == warned
