"""Disturbances of objects: levels as configured, reproducible by seed."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.shared.recognition.disturbances import (
    PAPER_LEVELS,
    Disturbance,
    add_noise,
    disturb,
    down_sample,
    draw_outliers,
    occlude,
)


@pytest.fixture
def box(rng):
    return rng.uniform(size=(4000, 3)) * [4.0, 2.0, 8.0] + [500_000.0, 5_800_000.0, 30.0]


def test_noise_is_of_the_deviation_in_normalised_space(box, rng):
    moved = add_noise(box, 0.05, rng) - box
    np.testing.assert_allclose(moved.std(axis=0), 0.05 * np.array([2.0, 1.0, 4.0]), rtol=0.05)
    np.testing.assert_allclose(moved.mean(axis=0), 0.0, atol=0.01)


def test_down_sampling_keeps_its_share_and_one_point_at_least(box, rng):
    rows = down_sample(box, 1 / 64, rng)
    assert len(rows) == round(4000 / 64) and (np.diff(rows) > 0).all()
    assert down_sample(box[:1], 0.01, rng).tolist() == [0]


def test_outliers_are_the_share_of_equation_13_and_lie_in_the_box(box, rng):
    far = draw_outliers(box, 0.3, rng)
    assert len(far) / (len(far) + len(box)) == pytest.approx(0.3, abs=1e-3)
    assert (far >= box.min(axis=0)).all() and (far <= box.max(axis=0)).all()
    assert len(draw_outliers(box, 0.0, rng)) == 0


def test_occlusion_hides_its_share_of_the_box_from_one_side(box):
    sides = set()
    for seed in range(20):
        left = box[occlude(box, 0.25, np.random.default_rng(seed))]
        assert len(left) / len(box) == pytest.approx(0.75, abs=0.03)
        lost = np.ptp(box, axis=0) - np.ptp(left, axis=0)
        (axis,) = np.flatnonzero(lost > 0.2)
        assert axis < 2 and lost[axis] == pytest.approx(0.25 * np.ptp(box[:, axis]), abs=0.05)
        sides.add((int(axis), bool(left[:, axis].min() > box[:, axis].min() + 0.2)))
    assert len(sides) == 4
    assert len(occlude(box[:1], 0.5, np.random.default_rng(0))) == 1


def test_all_together_repeat_and_carry_intensities(box):
    intensity = np.linspace(0, 1, len(box))
    one, values = disturb(box, PAPER_LEVELS[2], seed=5, intensity=intensity)
    other, again = disturb(box, PAPER_LEVELS[2], seed=5, intensity=intensity)
    assert one.tobytes() == other.tobytes() and values.tobytes() == again.tobytes()
    assert len(one) == len(values) == round(2000 / 0.7) and np.isin(values, intensity).all()
    same, nothing = disturb(box, Disturbance(), seed=1)
    assert same.tobytes() == box.tobytes() and nothing is None
    assert [(d.keep, d.noise, d.outliers) for d in PAPER_LEVELS] == [
        (0.5, 0.01, 0.1),
        (0.5, 0.03, 0.2),
        (0.5, 0.05, 0.3),
    ]


def test_bad_levels_and_objects_are_named(box):
    for changes, message in (
        ({"keep": 0.0}, "keep must be above 0 and at most 1, got 0.0"),
        ({"noise": -1.0}, "noise must be at least 0 and finite, got -1.0"),
        ({"outliers": 1.0}, "outliers must be at least 0 and below 1, got 1.0"),
        ({"occlusion": 1.5}, "occlusion must be at least 0 and below 1, got 1.5"),
    ):
        with pytest.raises(ParameterError, match=message):
            Disturbance(**changes)
    with pytest.raises(DataError, match="needs at least 1 points, got 0"):
        disturb(box[:0], Disturbance(), seed=1)
