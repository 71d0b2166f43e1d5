"""Estimates of a check: Wilson's interval, and its share of covered truths in simulated checks."""

import numpy as np
import pytest
from scipy.stats import binomtest

from mlsroad_pipeline.review.delivery.protocol import UNKNOWN, strata_of, wilson


@pytest.mark.parametrize(("right", "size"), [(0, 1), (8, 10), (30, 30), (17, 61)])
def test_the_interval_is_that_of_scipy(right, size):
    expected = binomtest(right, size).proportion_ci(method="wilson")
    found = wilson(right / size, size)
    np.testing.assert_allclose([found.low, found.high], [expected.low, expected.high], atol=1e-12)
    assert found.share == right / size


def test_a_list_that_was_looked_at_as_a_whole_has_no_uncertainty():
    score, right = np.linspace(0.4, 1, 30), np.arange(30) % 3 > 0
    assert strata_of(score, np.ones(30, bool), right).precision == (20 / 30,) * 3


def test_without_decisions_nothing_is_estimated():
    assert strata_of(np.array([0.5, 0.9]), np.zeros(2, bool), np.zeros(2, bool)).precision is UNKNOWN
    assert strata_of(np.zeros(0), np.zeros(0, bool), np.zeros(0, bool)).precision is UNKNOWN


@pytest.mark.parametrize("looked_at", [15, 60])
def test_uncertain_objects_that_come_first_do_not_bias_the_precision(looked_at):
    """Right with the probability of the score; two thirds of the decisions are about the lower half of the scores."""
    generator = np.random.default_rng(0)
    covered, errors, plain = 0, [], []
    for _ in range(400):
        score = np.sort(generator.uniform(0.4, 1.0, 200))
        right = generator.random(200) < score
        weight = np.where(np.arange(200) < 100, 2.0, 1.0)
        chosen = generator.choice(200, looked_at, replace=False, p=weight / weight.sum())
        decided = np.isin(np.arange(200), chosen)
        found = strata_of(score, decided, right & decided).precision
        covered += found.low <= right.mean() <= found.high
        errors.append(found.share - right.mean())
        plain.append(right[decided].mean() - right.mean())
    assert covered >= 0.92 * 400
    assert abs(np.mean(errors)) < 0.6 * abs(np.mean(plain))
