"""Lines of arcs: through their positions, without kinks, and places that come back from way and side."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.geometry.arcs import ArcLine, spread

ANGLE = np.linspace(0, 1.5 * np.pi, 12)
LINES = {
    "straight": np.column_stack([np.arange(0, 50, 10.0), np.zeros(5)]),
    "circle": 391_000.0 + 40 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)]),
    "corner": np.array([[0, 0], [20, 0], [25, 4], [26, 12], [26, 40.0]]),
    "turns back": np.array([[0, 0], [10, 0], [20, 0], [10, 0], [0, 0.0]]),
    "random": np.cumsum(np.random.default_rng(4).normal([6, 0], 3, (30, 2)), axis=0),
}


@pytest.mark.parametrize("name", LINES)
def test_the_line_leads_through_its_positions_without_a_kink(name):
    line = ArcLine.through(LINES[name], before=3.0, after=2.0)
    np.testing.assert_allclose(line.at(line.nodes)[0], LINES[name], atol=1e-7)
    before, after = (line.at(np.clip(line.starts[1:] + step, 0, line.length)) for step in (-1e-6, 1e-6))
    np.testing.assert_allclose(before[0], after[0], atol=1e-5)
    turned = np.mod(before[1] - after[1] + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0, atol=1e-4)
    assert line.length == pytest.approx(line.nodes[-1] + 2.0) and line.nodes[0] == 3.0
    assert (np.diff(line.nodes) >= np.hypot(*np.diff(LINES[name], axis=0).T) - 1e-9).all()


@pytest.mark.parametrize("name", LINES)
def test_places_come_back_from_way_and_side(name):
    positions = LINES[name]
    places = np.random.default_rng(1).uniform(positions.min(axis=0) - 30, positions.max(axis=0) + 30, (4000, 2))
    line = ArcLine.beside(positions, places)
    assert line.length > ArcLine.through(positions).length
    way, side = line.locate(places)
    np.testing.assert_allclose(line.at(way, side)[0], places, atol=1e-4)
    samples = line.at(np.linspace(0, line.length, 4000))[0]
    nearest = np.hypot(*(places[:, None, :] - samples[None, ::4, :]).transpose(2, 0, 1)).min(axis=1)
    assert (np.abs(side) <= nearest + 0.6).all()  # of several feet it is that of the nearest


def test_a_circle_is_a_circle():
    line = ArcLine.through(LINES["circle"])
    inner = line.pieces.curvature[2:-2]
    np.testing.assert_allclose(inner, 1 / 40, atol=1e-9)
    assert line.at([line.nodes[5]], [40.0])[0] == pytest.approx(np.full((1, 2), 391_000.0))


def test_positions_are_spread_by_distance_and_a_standing_vehicle_adds_none():
    rng = np.random.default_rng(0)
    drive = np.column_stack([np.linspace(0, 52, 200), np.zeros(200)])
    standing = drive[100] + rng.normal(0, 0.02, (500, 2))
    rows = spread(np.vstack([drive[:100], standing, drive[100:]]), 10.0)
    assert len(rows) == 6 and rows[0] == 0 and rows[-1] == 699
    assert spread([[0, 0], [1.0, 0]], 10.0).tolist() == [0, 1]
