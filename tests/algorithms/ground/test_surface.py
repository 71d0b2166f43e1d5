import numpy as np
import pytest
from references import ground as references

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.ground.surface import GroundSurface, height_above_ground


@pytest.fixture
def slope(rng):
    """Ground of a 10 % slope and points 0 to 5 m above it."""
    xy = rng.uniform(0, 20, (20_000, 2))
    plane = np.column_stack([xy, 0.1 * xy[:, 0]])
    above = rng.uniform(0, 5, 2000)
    high = plane[:2000] + np.column_stack([np.zeros((2000, 2)), above])
    return np.concatenate([plane, high]), np.arange(22_000) < 20_000, above


def test_height_above_a_slope_is_what_was_planted(slope):
    xyz, ground, above = slope
    heights = height_above_ground(xyz, ground)
    assert heights.dtype == np.float32
    inner = (np.abs(xyz[:, :2] - 10) < 9.5).all(axis=1)
    expected = np.concatenate([np.zeros(20_000), above])
    np.testing.assert_allclose(heights[inner], expected[inner], atol=0.03)
    np.testing.assert_allclose(heights, expected, atol=0.08)  # at the rim there is nothing to interpolate with


def test_cell_is_the_mean_of_its_ground_near_the_lowest():
    xyz = np.array([[0.1, 0.1, 1.0], [0.2, 0.2, 1.1], [0.3, 0.3, 1.2], [0.4, 0.4, 2.0], [0.0, 0.0, 9.0]])
    ground = np.array([True, True, True, True, False])
    surface = GroundSurface.from_points(xyz, ground, cell_size=1.0, spread=0.3)
    assert surface.elevation([[0.5, 0.5]])[0] == pytest.approx(1.1, abs=1e-5)
    wide = GroundSurface.from_points(xyz, ground, cell_size=1.0, spread=2.0)
    assert wide.elevation([[0.5, 0.5]])[0] == pytest.approx(5.3 / 4, abs=1e-5)


def test_gap_takes_inverse_square_distances_of_the_nearest_cells():
    xyz = np.array([[0.5, 0.5, 0.0], [10.5, 0.5, 4.0], [0.0, 0.0, 9.0]])
    surface = GroundSurface.from_points(xyz, [True, True, False], cell_size=1.0)
    # Cell centres 4 m and 6 m away: weights 1/16 and 1/36.
    assert surface.elevation([[4.5, 0.5]])[0] == pytest.approx(4.0 * (1 / 36) / (1 / 16 + 1 / 36), abs=1e-5)
    nearest = GroundSurface.from_points(xyz, [True, True, False], cell_size=1.0, n_neighbours=1)
    assert nearest.elevation([[4.5, 0.5], [60.5, 0.5]]).tolist() == [0.0, 4.0]


def test_blocks_meet_without_a_step(slope):
    xyz, ground, _ = slope
    x = np.arange(1.0, 19.0, 0.01)
    z = GroundSurface.from_points(xyz, ground).elevation(np.column_stack([x, np.full_like(x, 7.9)]))
    assert np.abs(np.diff(z)).max() < 0.01


def test_scene_without_ground_is_nan():
    heights = height_above_ground(np.ones((3, 3)), np.zeros(3, dtype=bool))
    assert heights.dtype == np.float32
    assert np.isnan(heights).all()
    assert np.isnan(GroundSurface.from_points(np.ones((3, 3)), np.zeros(3, dtype=bool)).elevation([[0.0, 0.0]])).all()


def test_empty_scene_is_empty():
    assert height_above_ground(np.empty((0, 3)), np.empty(0, dtype=bool)).shape == (0,)


def test_invariances(rng):
    xyz, truth = references.street(rng, n_ground=8000)
    before = xyz.copy()
    heights = height_above_ground(xyz, truth)
    np.testing.assert_array_equal(xyz, before)
    for n_threads in (2, 3):
        np.testing.assert_array_equal(height_above_ground(xyz, truth, n_threads=n_threads), heights)
    order = rng.permutation(len(xyz))
    np.testing.assert_array_equal(height_above_ground(xyz[order], truth[order]), heights[order])
    there = height_above_ground(xyz + np.array([458_000.0, 5_428_000.0, 100.0]), truth)
    assert np.quantile(np.abs(there - heights), 0.999) < 1e-3


@pytest.mark.parametrize(
    ("arguments", "parameters", "error", "message"),
    [
        ((np.zeros((2, 3)), np.zeros(3, dtype=bool)), {}, DataError, r"ground must have shape \(2,\), got \(3,\)"),
        ((np.zeros((2, 2)), np.zeros(2, dtype=bool)), {}, DataError, r"must have shape \(n, 3\)"),
        (([[0, 0, np.nan]], [True]), {}, DataError, "NaN or infinite"),
        ((np.zeros((1, 3)), [True]), {"cell_size": 0.0}, ParameterError, "cell_size"),
        ((np.zeros((1, 3)), [True]), {"spread": -1.0}, ParameterError, "spread"),
        ((np.zeros((1, 3)), [True]), {"n_neighbours": 0}, ParameterError, "n_neighbours must be at least 1, got 0"),
        ((np.zeros((1, 3)), [True]), {"n_threads": 0}, ParameterError, "n_threads"),
    ],
)
def test_bad_input_is_named(arguments, parameters, error, message):
    with pytest.raises(error, match=message):
        height_above_ground(*arguments, **parameters)


def test_surface_needs_points_and_finite_places():
    with pytest.raises(DataError, match="at least 1 points, got 0"):
        GroundSurface.from_points(np.empty((0, 3)), np.empty(0, dtype=bool))
    surface = GroundSurface.from_points(np.zeros((1, 3)), [True])
    with pytest.raises(DataError, match=r"xy must be finite of shape \(m, 2\)"):
        surface.elevation([[0.0, np.nan]])
