"""Offsets between two recordings: planted shifts and turns are found, and nothing where nothing measures them."""

import numpy as np
import pytest
from helpers.twin_streets import rectangle, street

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.registration.offset import find_offset
from mlsroad_pipeline.algorithms.registration.surfaces import find_surfaces, turn_of


@pytest.mark.parametrize(
    ("shift", "degrees"),
    [((0.0, 0.0, 0.0), 0.0), ((0.05, 0.0, 0.02), 0.0), ((0.3, -0.42, 0.2), 0.2), ((-1.4, 1.4, 40.0), -0.2)],
)
def test_planted_offset_is_found(shift: tuple[float, ...], degrees: float) -> None:
    fixed, moving = street(1), street(2)
    middle = np.array([30.0, 0.0, 0.0])
    moved = (moving - middle) @ turn_of(np.radians(degrees)).T + middle + shift
    found = find_offset(fixed, moved)
    assert found is not None
    np.testing.assert_allclose(found.apply(moved), moving, atol=0.02)
    assert np.degrees(found.heading) == pytest.approx(-degrees, abs=0.02)
    assert (found.error < 0.02).all()
    assert not found.seam


def test_posts_measure_along_a_straight_street() -> None:
    moved = street(2, fronts=False) + [0.7, -0.2, 0.1]
    found = find_offset(street(1, fronts=False), moved)
    assert found is not None
    np.testing.assert_allclose(found.shift, [-0.7, 0.2, -0.1], atol=0.02)


def test_walls_of_one_direction_measure_no_plan_and_the_ground_the_height() -> None:
    bare = {"fronts": False, "posts": False}
    found = find_offset(street(1, **bare), street(2, **bare) + [0.0, 0.0, -0.3])
    assert found is not None
    assert np.isnan(found.shift[:2]).all() and np.isnan(found.error[:2]).all()
    assert found.shift[2] == pytest.approx(0.3, abs=0.01)
    assert found.heading == 0.0


def test_ground_alone_measures_the_height() -> None:
    found = find_offset(street(1, walls=False, fronts=False, posts=False), street(2) + [0.4, 0.0, 12.0])
    assert found is not None
    assert np.isnan(found.shift[:2]).all()
    assert found.shift[2] == pytest.approx(-12.0, abs=0.02)


def test_plants_and_few_points_measure_nothing() -> None:
    rng = np.random.default_rng(3)
    hedge = rng.random((40_000, 3)) * [30, 4, 3]
    assert find_offset(hedge, hedge + [0.2, 0.0, 0.0]) is None
    assert find_offset(street(1)[:20], street(2)) is None
    assert find_offset(np.empty((0, 3)), street(2)) is None


def test_recordings_far_apart_have_no_offset() -> None:
    assert find_offset(street(1), street(2) + [200.0, 0.0, 0.0]) is None


def test_bordering_recordings_have_the_step_of_their_ground() -> None:
    points = street(1)
    east = points[:, 0] > 30
    found = find_offset(points[~east], points[east] + [0.0, 0.0, 40.0])
    assert found is not None and found.seam
    assert np.isnan(found.shift[:2]).all()
    assert found.shift[2] == pytest.approx(-40.0, abs=0.3)


def test_moved_vehicles_do_not_change_the_offset() -> None:
    rng = np.random.default_rng(5)
    boxes = [rectangle((x, -3, 0.3), (4, 0, 0.1), (0, 0, 1.2), 0.08, rng) for x in (3, 14, 26, 38, 50)]
    fixed = np.concatenate([street(1), *boxes])
    moved = np.concatenate([street(2), *(box + [1.1, 0.35, 0.0] for box in boxes)]) + [0.2, 0.1, 0.05]
    found = find_offset(fixed, moved)
    assert found is not None
    np.testing.assert_allclose(found.shift, [-0.2, -0.1, -0.05], atol=0.02)


def test_poles_seen_from_two_sides_have_one_axis() -> None:
    poles = [find_surfaces(street(seed)).pole for seed in (1, 2)]
    for pole in poles:
        gap = np.hypot(*(pole[:, None, :2] - np.array([(8, -5), (21, 5.2), (33, -5.1), (47, 5), (55, -5)])).T).min(
            axis=0
        )
        assert len(pole) > 30
        assert np.quantile(gap, 0.9) < 0.02


def test_limits_must_be_positive() -> None:
    with pytest.raises(ParameterError, match="largest_plan"):
        find_offset(street(1), street(2), largest_plan=0.0)
