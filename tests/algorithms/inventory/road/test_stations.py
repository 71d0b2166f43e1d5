"""Stations of a road: places along and across a smooth path, for each of its passes."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.road.stations import REACH, RoadPath, check_driven
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

ORIGIN = np.array([400_000.0, 5_700_000.0, 30.0])


def straight(length=100.0, step=0.5, jitter=0.0):
    x = np.arange(0.0, length + step / 2, step)
    y = jitter * np.random.default_rng(1).normal(size=len(x))
    return Trajectory.from_positions(np.column_stack([x, y, np.zeros(len(x))]) + ORIGIN)


def test_points_beside_a_straight_path_have_their_coordinates():
    path = RoadPath.along(straight())
    assert len(path) == 100
    xy = np.random.default_rng(2).uniform([0.5, -12], [99.5, 12], (500, 2))
    places = path.locate(np.column_stack([xy, np.zeros(500)]) + ORIGIN)
    assert np.array_equal(np.sort(places.row), np.arange(500))
    assert np.allclose(places.station, xy[places.row, 0]) and np.allclose(places.offset, -xy[places.row, 1])
    assert np.allclose(path.across(np.array([10]), np.array([2.0])), [[10.5, -2.0]] + ORIGIN[:2])


def test_the_jitter_of_positions_is_smoothed_but_the_ends_stay():
    path = RoadPath.along(straight(jitter=0.05))
    assert np.abs(path.xyz[:, 1] - ORIGIN[1]).max() < 0.06
    assert np.abs(np.degrees(np.arcsin(path.forward[:, 1]))).max() < 4.0


def test_points_too_far_away_or_beyond_the_ends_have_no_place():
    path = RoadPath.along(straight())
    outside = np.array([[50.0, REACH + 0.1, 0], [-1, 0, 0], [101, 0, 0]]) + ORIGIN
    assert len(path.locate(outside).row) == 0 and len(path.locate(np.zeros((0, 3))).row) == 0


def test_a_point_between_two_passes_has_a_place_in_each():
    x = np.arange(0.0, 200.5, 0.5)
    turn = np.linspace(-np.pi / 2, np.pi / 2, 40)[1:-1]
    there, back = np.column_stack([x, np.zeros_like(x)]), np.column_stack([x[::-1], np.full_like(x, 4.0)])
    bend = np.column_stack([200 + 2 * np.cos(turn), 2 + 2 * np.sin(turn)])
    xy = np.concatenate([there, bend, back])
    path = RoadPath.along(Trajectory.from_positions(np.column_stack([xy, np.zeros(len(xy))])))
    places = path.locate(np.array([[60.0, 7.0, 0.0]]))
    assert places.row.tolist() == [0, 0] and places.station[0] == pytest.approx(60.0, abs=0.01)
    assert places.offset.tolist() == pytest.approx([-7.0, 3.0], abs=0.01)


def test_a_path_shorter_than_a_station_is_an_error():
    with pytest.raises(DataError, match=r"0\.60 m long"):
        RoadPath.along(Trajectory.from_positions([[0.0, 0, 0], [0.6, 0, 0]]))


def test_scattered_places_are_no_path_but_a_turned_and_jittering_one_is():
    rng = np.random.default_rng(3)
    scattered = Trajectory.from_positions(rng.uniform(0, 80, (40, 3)) + ORIGIN, source="trees.csv")
    with pytest.raises(DataError, match=r"trees\.csv is not a path: \d+ of 38 steps turn back"):
        check_driven(scattered)
    there = np.column_stack([np.arange(0, 60, 0.2), np.zeros(300), np.zeros(300)])
    driven = np.concatenate([there, there[::-1] + [0, 0.3, 0]]) + rng.normal(0, 0.02, (600, 3)) + ORIGIN
    check_driven(Trajectory.from_positions(driven))
