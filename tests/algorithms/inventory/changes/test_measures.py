"""Changes of measures of planted objects by their points."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.inventory.changes.measures import (
    growth_of_crown,
    panel_in_both,
    rays_through_panel,
    turn_of_axis,
)

BASE = np.array([500.0, 700.0, 30.0])


def shaft(tilt, azimuth, seen_from, rng, *, height=7.0, n=1500):
    """Return the points of a pole of 0.1 m radius on the side of a scanner, and its row."""
    up = rng.uniform(0.1, height, n)
    turn = np.radians(seen_from) + rng.uniform(-1.2, 1.2, n)
    way = np.array([np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))])
    lean = np.tan(np.radians(tilt)) * up[:, None] * way
    points = np.column_stack([0.1 * np.column_stack([np.sin(turn), np.cos(turn)]) + lean, up]) + BASE
    row = pd.Series(dict(zip("xyz", BASE, strict=True), height=height, tilt=tilt, lean_azimuth=azimuth))
    return points + rng.normal(0, 0.01, points.shape), row


@pytest.mark.parametrize(("turn", "least", "most"), [(0, 0, 0.3), (1, 0.7, 1.3), (2, 0.8, 2.3), (5, 2.0, 5.3)])
def test_the_turn_of_a_pole_does_not_depend_on_the_side_that_is_seen(turn, least, most):
    """Points far from the untilted axis are left out, so a large turn is a lower bound."""
    rng = np.random.default_rng(3)
    (before, first), (after, second) = shaft(1.0, 90.0, 0.0, rng), shaft(1.0 + turn, 90.0, 180.0, rng)
    assert least <= turn_of_axis(before, after, first, second) <= most


def test_a_wrongly_listed_tilt_and_an_arm_do_not_turn_a_pole():
    rng = np.random.default_rng(4)
    (before, first), (after, second) = shaft(0.5, 0.0, 0.0, rng), shaft(0.5, 0.0, 90.0, rng)
    arm = BASE + np.column_stack([rng.uniform(0, 0.8, 300), rng.normal(0, 0.02, 300), rng.uniform(6.5, 7, 300)])
    second["tilt"] = 2.0
    assert turn_of_axis(before, np.concatenate([after, arm]), first, second) < 0.5


def test_few_slices_give_no_turn():
    rng = np.random.default_rng(5)
    (before, first), (after, second) = shaft(0.0, 0.0, 0.0, rng), shaft(3.0, 0.0, 0.0, rng)
    low = after[after[:, 2] < BASE[2] + 1.5]
    assert np.isnan(turn_of_axis(before, low, first, second))
    assert np.isnan(turn_of_axis(before, after[:0], first, second))


def crown(rng, factor=1.0, n=4000):
    way = rng.normal(size=(n, 3))
    way[:, 2] = np.abs(way[:, 2])
    return BASE + np.array([0, 0, 4 * factor]) + 3 * factor * way / np.linalg.norm(way, axis=1, keepdims=True)


def test_a_crown_grows_in_most_cells():
    rng = np.random.default_rng(6)
    before = crown(rng)
    near = np.hypot(*(before[:, :2] - BASE[:2]).T) < 2
    grown = crown(rng, 1.15)
    grown = grown[np.hypot(*(grown[:, :2] - BASE[:2]).T) < 2]
    middle = float(BASE[2] + 3)
    assert growth_of_crown(before[near], grown, middle) == pytest.approx(0.15 * 7, abs=0.15)
    one_twig = np.concatenate([before[near], [BASE + [0, 0, 9.0]]])
    assert abs(growth_of_crown(before[near], one_twig, middle)) < 0.1
    assert np.isnan(growth_of_crown(before[near], grown[:0], middle))


def test_a_panel_that_both_surveys_have_did_not_move():
    rng = np.random.default_rng(7)

    def panel(bottom):
        n = 600
        plate = np.column_stack([rng.uniform(-0.4, 0.4, n), np.zeros(n), rng.uniform(bottom, bottom + 0.7, n)])
        post = np.column_stack([rng.normal(0, 0.03, (300, 2)), rng.uniform(0.2, bottom, 300)])
        return BASE + np.concatenate([plate, post])

    low = (BASE[2] + 1.5, BASE[2] + 2.2)
    assert panel_in_both(panel(1.5), panel(1.5), low) > 0.9
    assert panel_in_both(panel(1.5), panel(2.2), low) < 0.5 > panel_in_both(panel(2.2), panel(1.5), low[::-1])
    assert np.isnan(panel_in_both(panel(1.5)[:0], panel(2.2), low))


def test_rays_along_a_panel_do_not_cross_it():
    rng = np.random.default_rng(8)
    panel = BASE + np.column_stack([rng.uniform(-0.3, 0.3, 60), np.zeros(60), rng.uniform(2, 2.6, 60)])
    across = BASE + np.column_stack([rng.uniform(-0.25, 0.25, 50), np.full(50, 6.0), rng.uniform(2.1, 2.5, 50)])
    scanner = np.broadcast_to(BASE + [0, -6.0, 2.3], across.shape)
    assert rays_through_panel(panel, scanner, across) == 50
    assert rays_through_panel(panel, scanner, across - [0, 6.05, 0]) == 0  # they end at the panel
    assert rays_through_panel(panel, scanner, across + [0, 0, 5.0]) == 0
    turned = BASE + (across - BASE)[:, [1, 0, 2]]
    assert rays_through_panel(panel, np.broadcast_to(BASE + [-6.0, 0.1, 2.3], across.shape), turned) < 10
