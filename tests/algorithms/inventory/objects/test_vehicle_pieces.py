"""Vehicles in sparse scans: pieces that are one vehicle, and boxes of which a part was seen."""

import numpy as np
import pandas as pd
import pytest
from references.inventory import planted_box

from mlsroad_pipeline.algorithms.inventory.objects.fragments import join_sparse_pieces, join_voxels
from mlsroad_pipeline.algorithms.inventory.objects.measures import complete_vehicle, measure
from mlsroad_pipeline.algorithms.inventory.objects.merging import _without_pieces
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import voxelise
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

TOLERANCE = 0.3


def scanned_side(x=0.0, y=0.0, *, length=4.2, lines=0.5, step=0.25):
    """Points of scan lines on the upright side of a car, along x."""
    along, up = np.meshgrid(np.arange(0, length, step), np.arange(0.3, 1.5, lines))
    return np.column_stack([x + along.ravel(), np.full(along.size, y), up.ravel()])


def numbers_of(xyz):
    """Return the numbers of clusters before and after joining."""
    before = cluster(xyz, tolerance=TOLERANCE)
    return len(np.unique(before)), join_sparse_pieces(xyz, before, TOLERANCE)


def test_scan_lines_half_a_metre_apart_are_one_car():
    n_before, after = numbers_of(scanned_side())
    assert n_before == 3 and len(np.unique(after)) == 1


def test_two_sparse_cars_that_exceed_one_stay_two():
    first, second = scanned_side(), scanned_side(x=5.0)
    _, after = numbers_of(np.concatenate([first, second]))
    one, two = np.unique(after[: len(first)]), np.unique(after[len(first) :])
    assert len(one) == len(two) == 1 and one[0] != two[0]


def test_dense_cars_half_a_metre_apart_are_not_joined():
    cars = np.concatenate([scanned_side(y=y, length=2.0, lines=0.04, step=0.04) for y in (0.0, 0.5)])
    n_before, after = numbers_of(cars)
    assert n_before == 2 and len(np.unique(after)) == 2


def test_joining_does_not_depend_on_the_order_of_the_points():
    xyz = np.concatenate([scanned_side(), scanned_side(x=5.0), scanned_side(y=8.0, lines=0.6)])
    order = np.random.default_rng(2).permutation(len(xyz))
    _, after = numbers_of(xyz)
    _, again = numbers_of(xyz[order])
    pairs = pd.DataFrame({"one": after[order], "two": again}).drop_duplicates()
    assert len(pairs) == pairs["one"].nunique() == pairs["two"].nunique()


def measured(xyz):
    """Return the row of a vehicle with its voxels."""
    table, _ = voxelise(
        xyz, group=np.zeros(len(xyz), np.int32), core=np.ones(len(xyz), bool), confidence=np.ones(len(xyz)),
        height_above_ground=xyz[:, 2], origin=np.zeros(3), resolution=0.05,
    )  # fmt: skip
    voxels = join_voxels(table.assign(object=0, scene=0), resolution=0.05)[0]
    return measure(voxels, "vehicle"), voxels


def test_a_car_seen_from_the_side_gets_a_width_away_from_the_scanner():
    side = scanned_side(length=4.5, lines=0.1, step=0.05)
    roof = planted_box((2.2, 0.3, 1.45), 2.0, 0.4, 0.02, azimuth_degrees=90)  # sparser than the side
    row, voxels = measured(np.concatenate([side, roof[::4]]))
    found = complete_vehicle(row, voxels)
    assert row["width"] < 1.0 and found["complete"] == "width assumed"
    assert found["width"] == pytest.approx(1.75) and found["length"] == pytest.approx(row["length"])
    assert found["y"] == pytest.approx(0.9, abs=0.1) and found["heading"] == pytest.approx(90.0, abs=1.0)


def test_a_car_seen_from_behind_gets_its_length_along_the_street():
    rear = planted_box((0.0, 0.0, 0.9), 1.75, 0.04, 1.2, azimuth_degrees=90)
    row, voxels = measured(
        np.concatenate([rear, planted_box((0.0, 0.5, 1.45), 1.2, 0.9, 0.02, azimuth_degrees=90)[::9]])
    )
    found = complete_vehicle(row, voxels)
    assert found["complete"] == "length assumed" and found["length"] == pytest.approx(4.2)
    assert min(found["heading"], 180.0 - found["heading"]) < 3.0  # the end lies along x, the car along y
    assert found["y"] == pytest.approx(2.1, abs=0.2)


def test_whole_cars_and_vans_keep_their_box():
    row, voxels = measured(planted_box((0.0, 0.0, 0.8), 4.6, 1.85, 1.4))
    assert complete_vehicle(row, voxels) == {"complete": "measured"}
    row, voxels = measured(planted_box((0.0, 0.0, 1.4), 6.0, 0.3, 2.6))
    assert complete_vehicle(row, voxels) == {"complete": "measured"}


def test_pieces_within_the_box_of_a_vehicle_are_not_listed():
    """Beside a car: a piece with an assumed box in it, one beside it, one with a measured box, and a pole."""
    table = pd.DataFrame({
        "kind": ["vehicle"] * 4 + ["pole"], "x": [0.0, 0.5, 2.5, 0.2, 0.1], "y": [0.0, 1.5, 0.0, -1.0, 0.0],
        "length": 4.4, "width": 1.8, "heading": [0.0, 5.0, 0.0, 0.0, 0.0], "score": [0.9, 0.7, 0.8, 0.6, 0.9],
        "point_count": [900, 60, 80, 70, 50],
        "complete": ["measured", "length assumed", "width assumed", "measured", ""],
    })  # fmt: skip
    assert _without_pieces(table).index.tolist() == [0, 2, 3, 4]
    assert _without_pieces(table.assign(score=[0.3, 0.7, 0.8, 0.6, 0.9])).index.tolist() == [0, 1, 2, 3, 4]
