"""Foliage around the upper end of a line: a crown of its own, a neighbour's, none."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.crowns import CROWN_FEATURES, crown_features
from mlsroad_pipeline.algorithms.segmentation.stems import Stem


def line(low=0.0, high=8.0, base=(2.0, 3.0), slope=(0.05, 0.0)):
    return Stem(np.array(base), np.array(slope), low, high)


def foliage(middle, radius, low, high, n=4000, seed=0):
    rng = np.random.default_rng(seed)
    turn, reach = rng.uniform(0, 2 * np.pi, n), radius * np.sqrt(rng.uniform(0, 1, n))
    return np.column_stack([
        middle[0] + reach * np.cos(turn), middle[1] + reach * np.sin(turn), rng.uniform(low, high, n)
    ])  # fmt: skip


def measured(stems, xyz):
    return [dict(zip(CROWN_FEATURES, row, strict=True)) for row in crown_features(stems, xyz)]


def test_features_are_those_of_a_loop_over_places():
    stem, xyz = line(), foliage((3.0, 3.5), 5.0, 2.0, 12.0)
    (found,) = measured([stem], xyz)
    inner, outer, beside, above, top = 0, 0, 0, [], 0.0
    for x, y, z in xyz:
        dx, dy = x - 2.0 - 0.05 * z, y - 3.0
        r = np.hypot(dx, dy)
        if r >= 3.5:
            continue
        inner += r < 1.0 and z > 8.0
        outer += r >= 1.0 and z > 7.5
        beside += r > 0.3 and 4.0 < z <= 7.5
        if (z > 7.5 and r > 0.3) or z > 8.0:
            above.append((dx, dy, r))
            top = max(top, z - 8.0)
    above = np.array(above)
    assert found["crown_inner"] == pytest.approx(np.log1p(inner))
    assert found["crown_outer"] == pytest.approx(np.log1p(outer))
    assert found["beside"] == pytest.approx(np.log1p(beside))
    assert found["crown_aside"] == pytest.approx(np.hypot(*above[:, :2].mean(axis=0)) / above[:, 2].mean())
    assert found["crown_depth"] == pytest.approx(top)


def test_a_crown_lies_around_the_end_and_that_of_a_neighbour_aside():
    stem = line(slope=(0.0, 0.0))
    palm, beside, free = (
        measured([stem], xyz)[0]
        for xyz in (
            foliage((2.0, 3.0), 2.5, 7.5, 10.0),
            foliage((4.5, 3.0), 2.0, 4.0, 10.0),
            foliage((40.0, 3.0), 2.0, 4.0, 10.0),
        )
    )
    assert palm["crown_aside"] < 0.1
    assert beside["crown_aside"] > 0.8
    assert palm["beside"] == 0.0 < beside["beside"]
    assert palm["crown_outer"] > 6.0 and palm["crown_inner"] > 5.0
    assert (free["crown_outer"], free["crown_inner"], free["crown_depth"]) == (0.0, 0.0, 0.0)
    assert np.isnan(free["crown_aside"])


def test_a_leaning_line_is_extended_to_the_crown():
    leaning = line(slope=(0.3, 0.0))
    (found,) = measured([leaning], foliage(leaning.at(9.0), 1.0, 8.5, 9.5))
    assert found["crown_aside"] < 0.15


def test_without_stems_there_is_no_row():
    assert crown_features([], np.zeros((3, 3))).shape == (0, len(CROWN_FEATURES))
