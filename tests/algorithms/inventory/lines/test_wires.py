"""Wires: planted spans, stacks, gaps, bends, noise, scenes that are cut, recordings of conductors."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely

from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.lines.wires import WIRE_COLUMNS, join_wires, wire_points
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

ORIGIN = np.array([391_000.0, 5_820_000.0, 34.0])
CONDUCTORS = Path(os.environ.get("MLSROAD_DATA", "../shared/data")) / "real/wires_blunomy/data"
NAMES = {"easy": 3, "medium": 7, "hard": 3, "extrahard": 3}


def span(start, end, sag, *, n=400, noise=0.01, bend=0.0, seed=0):
    """Return points of a wire between two places, its middle `sag` below the chord and `bend` beside it."""
    rng = np.random.default_rng(seed)
    start, end = np.array(start, dtype=float), np.array(end, dtype=float)
    share = rng.random(n)[:, None]
    points = start + share * (end - start)
    along = (end - start)[:2] / np.hypot(*(end - start)[:2])
    middle = 4 * share * (1 - share)
    points[:, 2:] -= sag * middle
    points[:, :2] += bend * middle * [-along[1], along[0]]
    return points + rng.normal(0, noise, points.shape)


def wires_of(*clouds, core=None, heights=None, path=None):
    xyz = np.vstack(clouds)
    n = len(xyz)
    heights = xyz[:, 2] if heights is None else heights
    core = np.ones(n, dtype=bool) if core is None else core
    table = wire_points(xyz, heights, np.ones(n), core=core, origin=ORIGIN)
    return join_wires([table], path)


def test_a_planted_wire_has_its_length_sag_and_clearance():
    path = Trajectory.from_positions(np.array([[-10.0, -4, 0], [60, -4, 0]]) + ORIGIN)
    table = wires_of(span((0, 0, 8), (40, 0, 8), 1.0), path=path)
    assert table["kind"].tolist() == ["wire"] and list(table) == list(LINE_FIELDS)
    row = table.iloc[0]
    assert row["length"] == pytest.approx(40.0, abs=0.4) and row["sag"] == pytest.approx(1.0, abs=0.05)
    assert row["clearance"] == pytest.approx(7.0, abs=0.05) and np.isnan(row["height"])
    assert (row["from_station"], row["to_station"]) == pytest.approx((10.0, 50.0), abs=0.4)
    assert row["offset"] == pytest.approx(-4.0, abs=0.05)
    vertices = shapely.get_coordinates(shapely.from_wkt(row["line"]), include_z=True) - ORIGIN
    expected = 8.0 - vertices[:, 0] * (40.0 - vertices[:, 0]) / 400.0
    np.testing.assert_allclose(vertices[:, 2], expected, atol=0.03)
    np.testing.assert_allclose(vertices[:, 1], 0.0, atol=0.03)


def test_wires_side_by_side_and_in_a_stack_are_told_apart():
    clouds = [
        span((0, y, z), (35, y + 3, z), 0.6, seed=k) for k, (y, z) in enumerate([(0, 8), (0.5, 8), (0, 9), (0, 7.4)])
    ]
    table = wires_of(*clouds)
    assert len(table) == 4
    assert table["length"].tolist() == pytest.approx([35.1] * 4, abs=0.5)
    assert sorted(table["clearance"]) == pytest.approx([6.8, 7.4, 7.4, 8.4], abs=0.06)


@pytest.mark.parametrize("beside", [(0.3, 0.0), (0.5, 0.0), (0.0, 0.3)])
def test_close_wires_are_told_apart(beside):
    across, above = beside
    table = wires_of(
        span((0, 0, 8), (40, 0, 8), 0.8), span((0, across, 8 + above), (40, across, 8 + above), 0.8, seed=1)
    )
    assert table["length"].tolist() == pytest.approx([40.0, 40.0], abs=1.5)


def test_a_long_span_is_one_wire():
    (row,) = wires_of(span((0, 0, 20), (160, 0, 20), 5.0, n=1200)).to_dict("records")
    assert row["length"] == pytest.approx(160.0, abs=1.0) and row["sag"] == pytest.approx(5.0, abs=0.1)


def test_spans_on_both_sides_of_a_pole_are_two_wires():
    table = wires_of(span((0, 0, 8), (35, 0, 8), 0.8), span((35, 0, 8), (65, 14, 8), 0.6, seed=1))
    assert sorted(table["length"]) == pytest.approx([33.1, 35.0], abs=1.2)


@pytest.mark.parametrize(("gap", "number"), [(4.0, 1), (12.0, 2)])
def test_gaps_below_the_largest_are_bridged(gap, number):
    cloud = span((0, 0, 8), (40, 0, 8), 1.0)
    assert len(wires_of(cloud[np.abs(cloud[:, 0] - 20) > gap / 2])) == number


def test_a_wire_that_the_wind_moves_is_one():
    (row,) = wires_of(span((0, 0, 8), (45, 0, 8), 1.2, bend=0.4)).to_dict("records")
    assert row["length"] == pytest.approx(45.0, abs=0.6)


def test_foliage_with_the_class_of_wires_is_none():
    rng = np.random.default_rng(3)
    leaves = rng.normal(0, 0.7, (600, 3)) + [20, 6, 7]
    table = wires_of(span((0, 0, 8), (40, 0, 8), 1.0), leaves)
    assert table["length"].iloc[table["length"].argmax()] == pytest.approx(40.0, abs=0.4)
    assert table["length"].sum() < 46.0


def test_the_score_is_the_mean_probability_and_bounds_what_is_listed():
    cloud = span((0, 0, 8), (40, 0, 8), 1.0)
    core = np.ones(len(cloud), dtype=bool)
    for probability, listed in ((0.25, 0), (0.75, 1)):
        points = wire_points(cloud, cloud[:, 2], np.full(len(cloud), probability), core=core, origin=ORIGIN)
        table = join_wires([points])
        assert len(table) == listed
        assert join_wires([points], least_score=0.0)["score"].tolist() == [probability]


def test_scenes_give_the_wire_of_the_whole():
    cloud = span((0, 0, 8), (40, 0, 8), 1.0)
    whole = wires_of(cloud)
    parts = []
    for low, high in ((-1, 20), (20, 41)):
        core = (cloud[:, 0] >= low) & (cloud[:, 0] < high)
        parts.append(wire_points(cloud, cloud[:, 2], np.ones(len(cloud)), core=core, origin=ORIGIN))
    joined = join_wires(parts)
    assert len(joined) == 1 and joined["length"].iloc[0] == pytest.approx(whole["length"].iloc[0], abs=0.1)
    pd.testing.assert_frame_equal(join_wires(parts), joined)


def test_nothing_and_unknown_ground():
    empty = wire_points(
        np.zeros((3, 3)), np.zeros(3), np.full(3, 0.1), core=np.ones(3, dtype=bool), origin=ORIGIN,
    )  # fmt: skip
    assert list(empty) == list(WIRE_COLUMNS) and len(empty) == 0
    assert len(join_wires([empty])) == 0 and len(join_wires([])) == 0
    cloud = span((0, 0, 8), (40, 0, 8), 1.0)
    assert np.isnan(wires_of(cloud, heights=np.full(len(cloud), np.nan))["clearance"].iloc[0])


@pytest.mark.skipif(not CONDUCTORS.is_dir(), reason="no recordings of conductors below $MLSROAD_DATA")
@pytest.mark.parametrize("name", NAMES)
def test_conductors_of_recordings_are_counted(name):
    points = pd.read_parquet(CONDUCTORS / f"lidar_cable_points_{name}.parquet")[["x", "y", "z"]].to_numpy()
    table = wires_of(points)
    assert len(table) == NAMES[name]
    assert table["length"].min() > 49.0 and table["sag"].between(1.4, 2.2).all()
