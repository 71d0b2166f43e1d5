"""Edges of a carriageway: kerbs on both sides, gaps, junctions, islands, and paved ground without a kerb."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.road.edges import BRIDGED, KERB, PAVED, UNSEEN, find_edges, kerb_offsets
from mlsroad_pipeline.algorithms.inventory.road.stations import Located, RoadPath
from mlsroad_pipeline.algorithms.inventory.road.surface import Ground
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

LENGTH = 80
PATH = RoadPath.along(Trajectory.from_positions([[0.0, 0, 0], [LENGTH, 0, 0]]))
NO_GROUND = Ground.empty(LENGTH, 0.0)


def kerb(left, start=0.0, end=LENGTH, *, onto_road=False):
    """Return a kerb along x; its upper side is away from the path, or towards it."""
    line = np.array([[start, left, 0.0], [end, left, 0.0]])
    return line if (left > 0) != onto_road else line[::-1]


def test_kerbs_on_both_sides_give_the_width():
    edges = find_edges(PATH, NO_GROUND, [kerb(4.5), kerb(-2.0)])
    assert edges.width == pytest.approx(np.full(LENGTH, 6.5))
    assert edges.offset[:, 3] == pytest.approx([-4.5, 2.0]) and (edges.evidence == KERB).all()


def test_the_nearest_kerb_that_rises_outward_counts():
    lines = [kerb(4.5), kerb(3.0, 20, 30), kerb(-0.5)]
    left, right = kerb_offsets(PATH, lines)
    assert left[10] == pytest.approx(-4.5) and left[25] == pytest.approx(-3.0) and np.isnan(right).all()


def test_kerbs_beyond_an_island_or_a_gap_in_the_near_one_are_of_another_carriageway():
    island = [kerb(3.0, 0, 40), kerb(5.0, onto_road=True), kerb(12.0)]
    left, _ = kerb_offsets(PATH, island)
    assert left[:40] == pytest.approx(np.full(40, -3.0)) and np.isnan(left[41:]).all()
    left, _ = kerb_offsets(PATH, [kerb(3.0, 0, 40), kerb(3.0, 46, 80), kerb(12.0)])
    assert np.nanmax(np.abs(left)) < 3.1 and np.isnan(left[41:45]).all()
    widened, _ = kerb_offsets(PATH, [kerb(3.0, 0, 40), kerb(8.0, 40, 80)])
    assert widened[35] == pytest.approx(-3.0) and widened[45] == pytest.approx(-8.0)


def test_a_kerb_across_the_path_is_no_edge():
    assert np.isnan(kerb_offsets(PATH, [np.array([[10.0, 2, 0], [10.2, 12, 0]])])).all()


def test_a_dropped_kerb_is_bridged_and_a_long_gap_is_not():
    edges = find_edges(PATH, NO_GROUND, [kerb(4.0, 0, 30), kerb(4.1, 36, 80), kerb(-2.0, 0, 20), kerb(-2.0, 50, 80)])
    assert (edges.evidence[0, 31:35] == BRIDGED).all() and edges.offset[0, 33] == pytest.approx(-4.05, abs=0.02)
    assert (edges.evidence[1, 22:48] == UNSEEN).all() and np.isnan(edges.width[22:48]).all()


def test_a_junction_is_not_bridged_between_corners_that_turn_away():
    angle = np.linspace(0, np.pi / 2, 30)
    corner = np.column_stack([30 + 5 * np.sin(angle), 4 + 5 - 5 * np.cos(angle), np.zeros(30)])
    other = corner * [-1, 1, 1] + [76, 0, 0]
    into = np.concatenate([[[0.0, 4, 0]], corner])
    out_of = np.concatenate([other[::-1], [[LENGTH, 4, 0]]])
    left = find_edges(PATH, NO_GROUND, [into, out_of, kerb(-2.0)])
    assert (left.evidence[0, :29] == KERB).all() and (left.evidence[0, 36:40] == UNSEEN).all()


def test_paved_ground_ends_at_natural_ground_where_no_kerb_is_near():
    rng = np.random.default_rng(3)
    n = 200_000
    station, offset = rng.uniform(0, LENGTH, n), rng.uniform(-8, 8, n)
    ground = Ground.empty(LENGTH, 0.0)
    ground.add(Located(np.arange(n), station, offset), np.zeros(n), (offset < -3.5) | (offset > 2.8))
    edges = find_edges(PATH, ground, [])
    assert edges.width == pytest.approx(np.full(LENGTH, 6.3), abs=0.11) and (edges.evidence == PAVED).all()
    edges = find_edges(PATH, ground, [kerb(3.2, 30, 50)])
    assert (edges.evidence[0, 31:49] == KERB).all() and (edges.evidence[0, 25:29] == UNSEEN).all()
    assert (edges.evidence[0, :15] == PAVED).all() and (edges.evidence[1] == PAVED).all()
