"""Temperatures against closed forms and a search over a grid."""

import numpy as np
import pytest
from scipy.special import softmax

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.temperature import BOUNDS, fit_temperature


def drawn(rng, n=20_000, scale=1.0):
    """Draw scores and classes with the probabilities of the scores, which are then scaled."""
    scores = rng.normal(0, 2, (n, 4))
    chances = np.cumsum(softmax(scores, axis=1), axis=1)
    return scale * scores, np.minimum((rng.random((n, 1)) > chances).sum(axis=1), 3)


@pytest.mark.parametrize("scale", [0.25, 1.0, 4.0])
def test_scale_of_calibrated_scores_is_found(rng, scale):
    scores, truth = drawn(rng, scale=scale)
    assert fit_temperature(scores, truth) == pytest.approx(scale, rel=0.05)


def test_it_is_the_minimum_of_the_loss_with_weights_and_partial_labels(rng):
    scores, truth = drawn(rng, n=300)
    allowed = np.eye(4, dtype=bool)[truth] | (rng.random((300, 4)) < 0.1)
    weights = rng.uniform(0, 3, 300)

    def loss(temperature):
        return -(weights * np.log((softmax(scores / temperature, axis=1) * allowed).sum(axis=1))).sum()

    grid = np.geomspace(0.2, 5, 2000)
    best = grid[np.argmin([loss(t) for t in grid])]
    assert fit_temperature(scores, allowed, weights=weights) == pytest.approx(best, rel=0.01)


def test_unknown_classes_and_weights_of_0_leave_samples_out(rng):
    scores, truth = drawn(rng, n=400)
    kept = np.arange(400) < 200
    expected = fit_temperature(scores[:200], truth[:200])
    assert fit_temperature(scores, np.where(kept, truth, -1)) == pytest.approx(expected)
    assert fit_temperature(scores, truth, weights=kept) == pytest.approx(expected)


def test_scores_without_errors_get_a_temperature_at_the_bound():
    assert fit_temperature(np.eye(3), [0, 1, 2]) == pytest.approx(BOUNDS[0], rel=1e-3)


@pytest.mark.parametrize(
    ("scores", "truth", "weights", "message"),
    [
        ([1.0, 2.0], [0, 1], None, r"scores must have the shape \(n, classes\), got \(2,\)"),
        ([[1.0, 2.0]], [2], None, "truth must have classes below 2 for each of 1 samples"),
        ([[1.0, 2.0]], [0.5], None, "truth must have classes below 2"),
        ([[1.0, 2.0]], [-1], None, "no sample has a true class"),
        (np.zeros((0, 2)), np.zeros(0, int), None, "no sample has a true class"),
        ([[1.0, 2.0]], [0], [1.0, 2.0], r"1 scores need as many weights, got \(2,\)"),
    ],
)
def test_bad_input(scores, truth, weights, message):
    with pytest.raises(DataError, match=message):
        fit_temperature(scores, truth, weights=weights)
