"""Barriers: planted fences, walls and rails are found with their place and height; bushes, steps and pieces are not."""

import numpy as np
import pytest
import shapely
from helpers.labelled import scheme as configured_scheme

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.lines.barriers import CELL_COLUMNS, barrier_cells, join_barriers
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

SCHEME = ClassScheme.from_config("road_inventory", configured_scheme())
WALL, GROUND = (SCHEME.classes.index(name) for name in ("wall or fence", "paved ground"))
ORIGIN = np.array([389_000.0, 5_819_000.0, 40.0])
SLOPE = 0.05


def upright(rng, start, end, height, *, n=60, thick=0.02, low=0.0):
    """Return points of an upright surface on sloping ground, `n` per metre, and their heights above the ground."""
    start, end = np.array(start, dtype=float), np.array(end, dtype=float)
    length = np.hypot(*(end - start))
    number = int(n * length)
    place = start + rng.random((number, 1)) * (end - start) + rng.normal(0, thick, (number, 2))
    above = rng.uniform(low, height, number)
    return np.column_stack([place, SLOPE * place[:, 0] + above]), above


def cells(points, height, *, label=WALL, core=None, scheme=SCHEME):
    labels = np.full(len(points), label)
    core = np.ones(len(points), dtype=bool) if core is None else core
    return barrier_cells(points.astype(np.float32), height, labels, scheme=scheme, core=core, origin=ORIGIN)


def vertices(row):
    return shapely.get_coordinates(shapely.from_wkt(row["line"]), include_z=True) - ORIGIN


def test_a_fence_is_one_line_at_its_foot_with_its_height():
    points, height = upright(np.random.default_rng(1), (2, 3), (14, 8), 1.4)
    path = Trajectory.from_positions(np.array([[0.0, 0, 0], [20, 0, 0]]) + ORIGIN)
    (row,) = join_barriers([cells(points, height)], path).to_dict("records")
    assert row["kind"] == "barrier" and row["height"] == pytest.approx(1.35, abs=0.1)
    assert row["length"] == pytest.approx(13.0, abs=0.4) and row["offset"] == pytest.approx(-5.5, abs=0.2)
    line = vertices(row)
    along = np.array([12.0, 5.0]) / 13.0
    aside = (line[:, :2] - (2, 3)) @ (-along[1], along[0])
    assert np.abs(aside).max() < 0.08
    assert line[:, 2] == pytest.approx(SLOPE * line[:, 0], abs=0.05)


def test_a_corner_gives_two_lines_and_a_rail_counts():
    rng = np.random.default_rng(2)
    parts = [upright(rng, (0, 0), (8, 0), 1.8), upright(rng, (8, 0), (8, 6), 1.8)]
    parts.append(upright(rng, (0, 20), (12, 20), 0.8, low=0.45))
    found = join_barriers([cells(*map(np.concatenate, zip(*parts, strict=True)))])
    # Near a corner a cell has no direction.
    assert sorted(found["length"]) == pytest.approx([5.3, 7.3, 12.0], abs=0.6)
    rail = found[found["height"] < 1.0].iloc[0]
    assert vertices(rail)[:, 2] == pytest.approx(SLOPE * vertices(rail)[:, 0], abs=0.05)  # the foot, not the beam


def test_a_line_runs_across_the_border_of_scenes():
    points, height = upright(np.random.default_rng(3), (0, 0), (20, 0), 1.2)
    left = points[:, 0] < 9.93
    (row,) = join_barriers([cells(points, height, core=left), cells(points, height, core=~left)]).to_dict("records")
    assert row["length"] == pytest.approx(20.0, abs=0.4)


def test_bushes_steps_short_pieces_and_other_classes_are_no_barriers():
    rng = np.random.default_rng(4)
    bush = rng.normal([0, 0, 1.0], [1.5, 1.5, 0.4], (3000, 3))
    step = upright(rng, (0, 10), (10, 10), 0.15)
    piece = upright(rng, (0, 20), (2, 20), 1.5)
    stairs = np.column_stack([rng.uniform(0, 4, 4000), rng.uniform(30, 33, 4000)])
    stairs = np.column_stack([stairs, np.floor((stairs[:, 1] - 30) / 0.3) * 0.17])
    for points, height in ((bush, bush[:, 2]), step, piece, (stairs, stairs[:, 2])):
        assert len(join_barriers([cells(points, height)])) == 0
    fence = upright(rng, (0, 0), (10, 0), 1.5)
    assert len(cells(*fence, label=GROUND)) == 0 and len(cells(*fence, label=-1)) == 0
    assert join_barriers([cells(*fence, label=GROUND)]).empty and join_barriers([]).empty


def test_reflections_below_the_ground_are_no_barrier_nor_its_foot():
    rng = np.random.default_rng(8)
    fence, height = upright(rng, (0, 0), (10, 0), 1.5)
    mirrored, below = upright(rng, (0, 5), (10, 5), -0.3, low=-1.8)
    assert len(join_barriers([cells(mirrored, below)])) == 0
    depth, deep = upright(rng, (0, 0), (10, 0), -0.3, low=-1.8)
    (row,) = join_barriers([cells(np.vstack([fence, depth]), np.append(height, deep))]).to_dict("records")
    assert row["least_height"] > 1.0 and vertices(row)[:, 2].min() > -0.05


def test_without_a_known_ground_the_foot_is_the_lowest_point():
    points, _ = upright(np.random.default_rng(5), (0, 0), (10, 0), 1.5)
    found = cells(points, np.full(len(points), np.nan, np.float32))
    assert list(found) == list(CELL_COLUMNS) and (found["foot"] == found["low"]).all()
    (row,) = join_barriers([found]).to_dict("records")
    assert row["height"] == pytest.approx(1.2, abs=0.2)


def test_the_lines_do_not_depend_on_the_order_of_the_points():
    points, height = upright(np.random.default_rng(6), (0, 0), (15, 5), 1.5)
    turned = np.random.default_rng(7).permutation(len(points))
    one, other = (join_barriers([cells(points[rows], height[rows])]) for rows in (slice(None), turned))
    assert len(one) == len(other) == 1
    assert other["length"].tolist() == pytest.approx(one["length"].tolist(), abs=0.3)
