"""Clearance: lowest points above a road, stray points, and their objects."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.road.clearance import Lowest, above_road, lowest_points
from mlsroad_pipeline.algorithms.inventory.road.stations import Located
from mlsroad_pipeline.algorithms.inventory.road.surface import CELL, CELLS, REACH, Planes


def points(*rows):
    """Return places and heights, labels and objects of points (station, offset, height, label, object)."""
    values = np.array(rows, dtype=np.float64)
    places = Located(np.arange(len(values)), values[:, 0], values[:, 1])
    return places, values[:, 2], values[:, 3].astype(np.uint8), values[:, 4].astype(np.uint32)


def test_the_lowest_point_with_others_beside_it_counts():
    lowest = Lowest.empty(6)
    branch = [(2.5 + 0.01 * k, 1.0, 4.2 + 0.02 * k, 5, 17) for k in range(10)]
    lowest.add(*points(*branch, (2.5, 1.0, 2.5, 9, 0), (4.5, -2.0, 3.0, 9, 0)))
    found = lowest_points(lowest)
    assert found.height[2] == pytest.approx(4.2) and found.offset[2] == pytest.approx(1.0, abs=0.13)
    assert (found.label[2], found.number[2]) == (5, 17)
    assert np.isnan(found.height[[0, 1, 3, 4, 5]]).all() and (found.label[[0, 1, 3, 4, 5]] == -1).all()


def test_a_wire_is_supported_across_cells_and_stations():
    lowest = Lowest.empty(4)
    lowest.add(*points((0.9, 0.2, 5.0, 8, 0), (1.5, 0.3, 5.1, 8, 0), (2.1, 0.4, 5.2, 8, 0)))
    assert lowest_points(lowest).height[1] == pytest.approx(5.1)


def test_order_and_parts_of_the_points_do_not_matter():
    rng = np.random.default_rng(4)
    rows = np.column_stack([
        rng.uniform(0, 20, 5000), rng.uniform(-6, 6, 5000), rng.uniform(2, 9, 5000), rng.integers(0, 9, 5000),
        rng.integers(0, 99, 5000),
    ])  # fmt: skip
    whole, parts = Lowest.empty(20), Lowest.empty(20)
    whole.add(*points(*rows))
    for part in np.array_split(rows[rng.permutation(5000)], 7):
        parts.add(*points(*part))
    for one, other in zip(lowest_points(whole), lowest_points(parts), strict=True):
        assert np.array_equal(one, other, equal_nan=True)


def test_heights_are_above_the_sloping_road_below():
    offset = (np.arange(CELLS) + 0.5) * CELL - REACH
    planes = Planes(np.array([0.5, 1.5]), np.full(2, 1.0), np.full(2, 0.02))
    surface = planes.height[:, None] - 0.02 * offset
    places = Located(np.arange(2), np.array([0.25, 1.75]), np.array([-3.05, 4.05]))
    z = places.station * 1.0 - 0.02 * places.offset + 4.5
    assert above_road(places, z, surface, planes) == pytest.approx([4.5, 4.5], abs=1e-9)
    unknown = planes._replace(slope=np.full(2, np.nan))
    assert np.isnan(above_road(places, z, surface, unknown)).all()
