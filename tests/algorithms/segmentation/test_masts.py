"""Long arms of masts, and the second legs of gantries, on planted places."""

import numpy as np

from mlsroad_pipeline.algorithms.segmentation.poles import _is_arm
from mlsroad_pipeline.algorithms.segmentation.stems import Stem
from mlsroad_pipeline.algorithms.segmentation.trunks import _find_second_legs


def box(rng, length, width, height, n=3000):
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    places = rng.uniform([0, 0, 5], [length, width, 5 + height], (n, 3))
    return np.column_stack([places[:, :2] @ turn, places[:, 2]])


def test_an_arm_is_long_narrow_and_flat_in_any_direction(rng):
    assert _is_arm(box(rng, 9.0, 0.5, 1.2))
    assert not _is_arm(box(rng, 15.0, 0.5, 1.2))  # a gantry's beam
    assert not _is_arm(box(rng, 6.0, 3.0, 1.2))  # a crown
    assert not _is_arm(box(rng, 6.0, 0.5, 3.0))


def stem(x, high):
    return Stem(np.array([x, 0.0]), np.zeros(2), 0.0, high)


def test_a_leg_is_found_by_the_beam_that_reaches_it(rng):
    beam = rng.uniform([0, -0.3, 6.5], [20, 0.3, 7.2], (4000, 3))
    stems = [stem(0.0, 7.0), stem(20.0, 7.2), stem(10.0, 4.0), stem(2.0, 7.0), stem(20.0, 7.0)]
    number = np.array([3, -1, -1, -1, -1])
    _find_second_legs(beam, stems[:4], number[:4])
    assert number.tolist() == [3, 3, -1, -1, -1]  # the third is too low, the fourth too near
    wires = beam[:200]
    alone = np.array([3, -1])
    _find_second_legs(wires, stems[:2], alone)
    assert alone.tolist() == [3, -1]
