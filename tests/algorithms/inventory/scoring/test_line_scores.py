"""Scores of lines, by hand."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.scoring.line_scores import places_along, score_lines

TRUE = places_along([[(0.0, 0.0), (10.0, 0.0)]])


def test_places_lie_in_the_middle_of_equal_pieces_of_each_line():
    places = places_along([[(0.0, 0.0), (0.2, 0.0), (0.2, 0.2)], [(5.0, 5.0, 1.0), (5.1, 5.0, 9.0)]])
    np.testing.assert_allclose(places, [[0.05, 0], [0.15, 0], [0.2, 0.05], [0.2, 0.15], [5.05, 5]])


def test_solid_places_differ_in_height():
    low, high = ([[(0.0, 0.0, z), (4.0, 0.0, z)]] for z in (5.0, 6.0))
    true, listed = places_along(low, solid=True), places_along(high, solid=True)
    assert true.shape == (40, 3) and score_lines(listed, true, within=0.5).found == 0.0
    assert score_lines(places_along(high), places_along(low), within=0.5).found == 1.0


def test_half_of_a_line_with_a_false_one():
    listed = places_along([[(0.0, 0.1), (5.0, 0.1)], [(0.0, 3.0), (5.0, 3.0)]])
    scores = score_lines(listed, TRUE, within=0.2)
    assert scores.true == pytest.approx(10.0) and scores.listed == pytest.approx(10.0)
    assert scores.found == pytest.approx(0.5, abs=0.02) and scores.right == 0.5
    assert score_lines(listed, TRUE, within=0.05)[2:] == (0.0, 0.0)
    hidden = places_along([[(0.0, 3.0), (5.0, 3.0)]])
    assert score_lines(listed, TRUE, within=0.2, uncounted=hidden).right == 1.0


def test_nothing_listed_and_nothing_true():
    nothing = places_along([])
    assert score_lines(nothing, TRUE, within=0.2).found == 0.0
    assert np.isnan(score_lines(nothing, TRUE, within=0.2).right)
    assert np.isnan(score_lines(TRUE, nothing, within=0.2).found)
    assert score_lines(TRUE, nothing, within=0.2).right == 0.0
    with pytest.raises(ParameterError, match="within"):
        score_lines(TRUE, TRUE, within=0)
    with pytest.raises(ParameterError, match="same number of coordinates"):
        score_lines(TRUE, TRUE, within=0.1, uncounted=np.zeros((3, 3)))
