import numpy as np
import pytest
from helpers.ground_scores import score_ground
from sklearn.metrics import cohen_kappa_score

from mlsroad_pipeline.algorithms.core.exceptions import DataError


def test_equals_counting_and_scikit_learn(rng):
    truth, predicted = rng.random(500) < 0.6, rng.random(500) < 0.5
    valid = rng.random(500) < 0.8
    scores = score_ground(predicted, truth, valid=valid)
    p, t = predicted[valid], truth[valid]
    assert scores.type_1 == pytest.approx(sum(t & ~p) / sum(t))
    assert scores.type_2 == pytest.approx(sum(~t & p) / sum(~t))
    assert scores.total == pytest.approx(np.mean(p != t))
    assert scores.kappa == pytest.approx(cohen_kappa_score(t, p))
    assert (scores.n_ground, scores.n_object) == (sum(t), sum(~t))


def test_perfect_and_opposite():
    truth = np.array([True, True, False, False])
    assert score_ground(truth, truth).kappa == 1.0
    opposite = score_ground(~truth, truth)
    assert (opposite.type_1, opposite.type_2, opposite.total, opposite.kappa) == (1.0, 1.0, 1.0, -1.0)


def test_undefined_values_are_nan():
    only_ground = score_ground(np.array([True, True]), np.array([True, True]))
    assert only_ground.type_1 == 0.0
    assert np.isnan(only_ground.type_2)
    assert np.isnan(only_ground.kappa)
    assert np.isnan(score_ground(np.empty(0, dtype=bool), np.empty(0, dtype=bool)).total)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1, 0], [True, False]), "is_ground must be boolean, got int64"),
        (([True], [True, False]), r"is_ground must have shape \(2,\), got \(1,\)"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(DataError, match=message):
        score_ground(*arguments)


def test_valid_must_fit():
    with pytest.raises(DataError, match=r"valid .*got \(3,\)"):
        score_ground([True, False], [True, False], valid=[True, True, True])
