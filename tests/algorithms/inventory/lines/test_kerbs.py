"""Kerbs: planted steps, what is no kerb, scenes that are cut, limits."""

import numpy as np
import pandas as pd
import pytest
import shapely

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS, numbered
from mlsroad_pipeline.algorithms.inventory.lines.kerbs import step_kernels
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import (
    STEP_COLUMNS,
    StepLimits,
    find_steps,
    join_kerbs,
    kerb_steps,
)
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.step_kernels import MOST_CELLS, ground_cells
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

ORIGIN = np.array([391_000.0, 5_820_000.0, 34.0])
GROUND, WHEEL = 0, 1
IS_GROUND = np.array([True, False])


def street(*, height=0.12, turn=0.0, slope=0.02, density=600, length=20.0, seed=1):
    """Return points of a road and a pavement, whose border is the x axis turned by `turn`; the pavement is on the left."""
    rng = np.random.default_rng(seed)
    along, across = rng.uniform(0, length, int(density * length * 6)), rng.uniform(-3, 3, int(density * length * 6))
    z = slope * across + 0.01 * along + height * np.clip(across / 0.02, 0, 1) + rng.normal(0, 0.004, len(along))
    c, s = np.cos(turn), np.sin(turn)
    return np.column_stack([along * c - across * s, along * s + across * c, z])


def steps_of(xyz, *, labels=None, core=None, **limits):
    n = len(xyz)
    labels = np.zeros(n, dtype=np.int64) if labels is None else labels
    core = np.ones(n, dtype=bool) if core is None else core
    height = np.zeros(n)
    return kerb_steps(xyz, height, labels, is_ground=IS_GROUND, core=core, origin=ORIGIN, limits=StepLimits(**limits))


def vertices(table):
    return [shapely.get_coordinates(shapely.from_wkt(text), include_z=True) - ORIGIN for text in table["line"]]


@pytest.mark.parametrize("turn", [0.0, 0.4, 2.1, -1.3])
@pytest.mark.parametrize("density", [150, 600])
def test_a_planted_kerb_is_one_line_along_its_foot(turn, density):
    table = join_kerbs([steps_of(street(turn=turn, density=density))])
    assert table["kind"].tolist() == ["kerb"]
    line = vertices(table)[0]
    along, across = line[:, :2] @ [np.cos(turn), np.sin(turn)], line[:, :2] @ [-np.sin(turn), np.cos(turn)]
    assert np.abs(np.median(across)) < 0.03 and np.abs(across).max() < 0.12
    assert table["length"].iloc[0] > 18.0 and np.all(np.diff(along) > 0)  # the upper side is on the left
    assert table["height"].iloc[0] == pytest.approx(0.12, abs=0.015)
    np.testing.assert_allclose(line[:, 2], 0.01 * along, atol=0.03)


def test_heights_below_and_above_the_limits_are_no_kerbs():
    assert len(join_kerbs([steps_of(street(height=0.03))])) == 0
    assert len(join_kerbs([steps_of(street(height=0.03), least_height=0.02)])) == 1
    assert len(join_kerbs([steps_of(street(height=0.4))])) == 0


@pytest.mark.parametrize("slope", [0.0, 0.15, 0.4])
def test_slopes_without_a_step_are_no_kerbs(slope):
    assert len(join_kerbs([steps_of(street(height=0.0, slope=slope))])) == 0


def test_points_of_other_classes_neither_make_nor_hide_a_kerb():
    ground = street()
    rng = np.random.default_rng(2)
    wheel = np.column_stack([rng.uniform(6, 9, 3000), rng.uniform(-0.4, -0.1, 3000), rng.uniform(0.0, 0.4, 3000)])
    cloud, labels = np.vstack([ground, wheel]), np.repeat([GROUND, WHEEL], [len(ground), len(wheel)])
    expected, found = join_kerbs([steps_of(ground)]), join_kerbs([steps_of(cloud, labels=labels)])
    pd.testing.assert_frame_equal(found, expected)
    unlabelled = np.where(labels == WHEEL, WHEEL, -1)
    pd.testing.assert_frame_equal(join_kerbs([steps_of(cloud, labels=unlabelled)]), expected)


def test_a_low_hedge_behind_the_kerb_is_left_out_as_an_outlier():
    ground = street()
    rng = np.random.default_rng(3)
    plants = np.column_stack([rng.uniform(0, 20, 2000), rng.uniform(0.5, 0.8, 2000), rng.uniform(0.15, 0.4, 2000)])
    line = vertices(join_kerbs([steps_of(np.vstack([ground, plants]))]))[0]
    assert np.abs(np.median(line[:, 1])) < 0.03 and np.ptp(line[:, 0]) > 18.0


def test_short_gaps_are_bridged_and_long_ones_are_not():
    cloud = street()
    bridged = cloud[np.abs(cloud[:, 0] - 10) > 0.6]
    assert len(join_kerbs([steps_of(bridged)])) == 1
    parted = cloud[np.abs(cloud[:, 0] - 10) > 1.6]
    assert len(join_kerbs([steps_of(parted)])) == 2
    assert len(join_kerbs([steps_of(parted)], least_length=30.0)) == 0


def test_scenes_with_buffers_give_the_line_of_the_whole():
    cloud = street()
    whole = steps_of(cloud)
    parts = []
    for low, high in ((-1.0, 9.95), (9.95, 21.0)):
        near = (cloud[:, 0] > low - 2) & (cloud[:, 0] < high + 2)
        core = (cloud[near, 0] >= low) & (cloud[near, 0] < high)
        parts.append(steps_of(cloud[near], core=core))
    assert abs(len(pd.concat(parts)) - len(whole)) <= 0.1 * len(whole)
    (line,) = vertices(join_kerbs(parts))
    assert np.abs(line[:, 1]).max() < 0.12 and np.ptp(line[:, 0]) > 18.0


def test_stations_and_sides_come_from_the_trajectory():
    path = Trajectory.from_positions(np.array([[-5.0, -2, 0], [30, -2, 0]]) + ORIGIN)
    table = join_kerbs([steps_of(street())], path)
    assert table["from_station"].iloc[0] == pytest.approx(5.0, abs=0.7)
    assert table["to_station"].iloc[0] == pytest.approx(25.0, abs=0.7)
    assert table["offset"].iloc[0] == pytest.approx(-2.0, abs=0.03)  # on the left
    twice = numbered([table, table])
    assert twice["line_id"].tolist() == [1, 2]


def test_nothing_is_found_in_nothing():
    empty = steps_of(np.zeros((0, 3)))
    assert list(empty) == list(STEP_COLUMNS) and len(empty) == 0
    for table in (join_kerbs([]), join_kerbs([empty]), numbered([])):
        assert list(table) == list(LINE_FIELDS) and len(table) == 0
        assert table.dtypes.astype(str)["line_id"] == "int64"
    unknown = kerb_steps(
        street(), np.full(72_000, np.nan), np.zeros(72_000, dtype=int), is_ground=IS_GROUND,
        core=np.ones(72_000, dtype=bool), origin=ORIGIN,
    )  # fmt: skip
    assert len(unknown) == 0


def test_wrong_limits_are_named():
    with pytest.raises(ParameterError, match="least_height must be a finite number > 0"):
        StepLimits(least_height=0)
    with pytest.raises(ParameterError, match=r"least_height 0\.4 is above most_height 0\.3"):
        StepLimits(least_height=0.4)


def test_a_neighbourhood_never_has_more_cells_than_there_is_room_for():
    rng = np.random.default_rng(4)
    for shift in rng.uniform(0, 0.1, 20):
        full = np.stack(np.meshgrid(np.arange(0, 4, 0.02), np.arange(0, 4, 0.02)), axis=-1).reshape(-1, 2)
        cells = ground_cells(np.column_stack([full + shift, np.zeros(len(full))]))
        inside = np.abs(cells.xyz[:, :2] - 2.0).max(axis=1) <= 1.25
        assert inside.sum() <= MOST_CELLS


def test_the_rise_over_the_cells_within_reach_of_a_block_is_that_over_all(rng):
    cells = rng.uniform([0, 0, 0], [2, 2, 0.3], (300, 3))
    around, close = np.ascontiguousarray(cells.T), np.empty((3, 300))
    members = np.flatnonzero((cells[:, :2] > 0.8).all(axis=1) & (cells[:, :2] < 1.2).all(axis=1))
    n_close = step_kernels._within_reach(cells, members, around, 300, close)
    assert len(members) < n_close < 300
    for own in members:
        assert step_kernels._rise(close, n_close, *cells[own]) == step_kernels._rise(around, 300, *cells[own])


def test_steps_of_wanted_cells_are_those_of_all(rng):
    x, y = (values.ravel() for values in np.meshgrid(np.arange(0, 6, 0.04), np.arange(-2, 2, 0.04)))
    xyz = np.column_stack([x, y, np.where(y > 0, 0.12, 0.0)]) + rng.normal(0, 0.003, (len(x), 3))
    cells = ground_cells(xyz)
    wanted = cells.xyz[:, 0] < 3
    whole, part = (find_steps(cells, xyz, StepLimits(), wanted=chosen) for chosen in (None, wanted))
    kept = wanted[whole.cell]
    assert 0 < kept.sum() < len(kept)
    for all_values, values in zip(
        (whole.xyz, whole.upward, whole.height, whole.roughness, whole.cell),
        (part.xyz, part.upward, part.height, part.roughness, part.cell),
        strict=True,
    ):
        np.testing.assert_array_equal(values, all_values[kept])
