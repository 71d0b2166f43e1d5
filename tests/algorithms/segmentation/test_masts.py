"""Long arms of masts, and the second legs of gantries, on planted places."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.segmentation.crowned_stems import _find_second_legs, find_least_pole_like, measure_stem
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import segment
from mlsroad_pipeline.algorithms.segmentation.poles import _is_arm
from mlsroad_pipeline.algorithms.segmentation.stems import Stem, StemLimits, find_stems


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


def test_leaves_on_one_side_of_a_pole_do_not_bend_it(rng):
    """The upper half of a straight pole, slope 0.05, has more leaves to its east than points of its own."""
    z = np.repeat(np.arange(0.05, 6.0, 0.1), 2)
    pole = np.column_stack([0.05 * z, np.zeros(len(z)), z]) + rng.normal(0, 0.01, (len(z), 3))
    leaves = np.column_stack([rng.uniform(0.35, 0.7, 400), rng.uniform(-0.2, 0.2, 400), rng.uniform(3, 6, 400)])
    leaves[:, 0] += 0.05 * (leaves[:, 2] - 3)
    xyz = np.concatenate([pole, leaves])
    counts = np.concatenate([np.full(len(pole), 5), np.ones(400, np.int64)])
    stem = Stem(np.zeros(2), np.array([0.05, 0.0]), 0.0, 6.0)
    bend, lean = np.exp(measure_stem(stem, xyz, counts, 0.5)[:2]) - 0.02
    assert bend < 0.02 and abs(lean - 0.05) < 0.01
    crooked = xyz + np.column_stack([0.25 * np.sin(1.5 * xyz[:, 2]), np.zeros(len(xyz)), np.zeros(len(xyz))])
    assert np.exp(measure_stem(stem, crooked, counts, 0.5)[0]) - 0.02 > 3 * bend


def test_the_least_pole_like_of_neighbouring_stems_carries_the_crown():
    at = [(0.0, 0.0), (2.0, 0.0), (4.0, 0.0), (20.0, 0.0)]
    stems = [Stem(np.array(base), np.zeros(2), 0.0, 5.0) for base in at]
    assert find_least_pole_like(stems, np.array([1.0, 2.0, 3.0, 9.0])).tolist() == [True, False, False, True]
    assert find_least_pole_like([], np.zeros(0)).tolist() == []


@pytest.mark.parametrize(
    ("height", "brightness", "thickness", "n_objects"),
    [
        (6.0, 0.6, 0.005, 2),
        (6.0, 0.31, 0.005, 2),  # a thin sheet need not be brighter
        (6.0, 0.31, 0.03, 1),  # a box of the mast's brightness
        (6.0, 0.33, 0.03, 2),  # the least contrast is 0.02
        (1.5, 0.6, 0.005, 1),  # lower than the least stem
    ],
)
def test_a_plate_is_separated_by_contrast_or_as_a_sheet_from_a_mast_that_is_high_enough(
    height, brightness, thickness, n_objects, rng
):
    angle, z = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0, height, 4000)
    mast = np.column_stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), z])
    low = min(2.5, height - 0.7)
    plate = np.column_stack(
        [rng.uniform(-0.4, 0.4, 3000), rng.normal(0.12, thickness, 3000), rng.uniform(low, low + 0.7, 3000)]
    )
    intensity = np.repeat([0.3, brightness], [4000, 3000])
    assert segment(np.concatenate([mast, plate]), intensity=intensity).max() + 1 == n_objects


def test_wider_limits_find_a_stem_in_sparse_scan_lines():
    """Scan lines are 0.28 m apart; a bent pole has sections off its line."""
    z = np.repeat(np.arange(0.05, 6.0, 0.28), 3)
    pole = np.column_stack([0.05 * np.tile([-1.0, 0.0, 1.0], len(z) // 3), np.zeros(len(z)), z])
    bent = pole + np.column_stack([0.1 * np.sin(2.0 * z), 0 * z, 0 * z])

    def n_stems(places, **limits):
        counts, clusters = np.ones(len(places), np.int64), np.zeros(len(places), np.int32)
        found = find_stems(places, counts, clusters, 2.0, StemLimits(section_height=0.3, **limits))
        return sum(len(stems) for _, _, stems in found)

    assert n_stems(pole) == 1
    assert n_stems(pole, section_tolerance=0.01) == 0  # sections of single points: others are too close
    assert n_stems(bent, max_shift=0.3) == 0
    assert n_stems(bent, max_residual=0.2, max_shift=0.02) == 0
    assert n_stems(bent, max_residual=0.2, max_shift=0.3) == 1
