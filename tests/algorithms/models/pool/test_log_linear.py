import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.pool.log_linear import LogLinearPool, PoolParameters, _sample
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import ClassPreference

PLAIN = PoolParameters(penalties=(1e-6,), balance=0.0, n_points=100_000)
CONFUSIONS = np.array(
    [
        [[0.8, 0.15, 0.05], [0.1, 0.6, 0.3], [0.3, 0.3, 0.4]],
        [[0.5, 0.25, 0.25], [0.4, 0.5, 0.1], [0.02, 0.03, 0.95]],
    ]
)
PRIOR = np.array([0.6, 0.3, 0.1])


def planted(rng, n):
    """Return truth, one-hot answers of two independent labellers, and the best possible probabilities."""
    truth = rng.choice(3, n, p=PRIOR)
    answers = [(table.cumsum(axis=1)[truth] < rng.random(n)[:, None]).sum(axis=1) for table in CONFUSIONS]
    best = PRIOR * CONFUSIONS[0][:, answers[0]].T * CONFUSIONS[1][:, answers[1]].T
    return truth, [np.eye(3)[a] for a in answers], best / best.sum(axis=1, keepdims=True)


def test_planted_confusions_are_undone_as_bayes_would(rng):
    truth, answers, _ = planted(rng, 60_000)
    pool = LogLinearPool.fit(answers, truth, parameters=PLAIN)
    truth, answers, best = planted(rng, 20_000)
    pooled = pool.predict_proba(answers)
    np.testing.assert_allclose(pooled, best, atol=0.03)
    assert np.array_equal(pooled.argmax(axis=1), best.argmax(axis=1))
    rule = ClassPreference.fit([a.argmax(axis=1) for a in answers], truth, n_classes=3)
    fused, _ = rule.fuse([a.argmax(axis=1) for a in answers])
    assert np.mean(pooled.argmax(axis=1) == truth) > np.mean(fused == truth)


def test_overconfident_probabilities_come_back_calibrated(rng):
    """A labeller that cubes the odds it ought to give has them taken to the cube root again."""
    truth = rng.integers(0, 2, 40_000)
    odds = rng.normal(2.0 * truth - 1.0, 1.0)  # log odds of class 1 are 2 x the value
    honest = 1 / (1 + np.exp(-2 * odds))
    loud = 1 / (1 + np.exp(-6 * odds))
    pool = LogLinearPool.fit(
        [np.column_stack([1 - loud, loud])], truth, parameters=PoolParameters(penalties=(1e-6,), balance=0, floor=1e-9)
    )
    pooled = pool.predict_proba([np.column_stack([1 - loud, loud])])[:, 1]
    assert np.abs(pooled - honest).max() < 0.05 < np.abs(loud - honest).max()


def test_without_penalty_it_is_a_logistic_regression_on_log_probabilities(rng):
    tables = [rng.dirichlet([1, 1, 1], 2000) for _ in range(2)]
    logits = np.log(tables[0]) @ [[1, 0, 0.5], [0, 0.7, 0], [0, 0, 0.2]] + 0.5 * np.log(tables[1])
    truth = (logits + rng.gumbel(size=logits.shape)).argmax(axis=1)
    floor = PoolParameters(penalties=(1e-9,), balance=0, floor=1e-12)
    pooled = LogLinearPool.fit(tables, truth, parameters=floor).predict_proba(tables)
    features = np.log(np.concatenate(tables, axis=1))
    expected = LogisticRegression(C=1e6, max_iter=2000, tol=1e-8).fit(features, truth).predict_proba(features)
    np.testing.assert_allclose(pooled, expected, atol=5e-3)


def test_a_labeller_that_does_not_see_a_point_has_no_say_there(rng):
    truth, answers, _ = planted(rng, 30_000)
    unseen = rng.random(len(truth)) < 0.5
    answers[1] = np.where(unseen[:, None], np.nan, answers[1])
    pool = LogLinearPool.fit(answers, truth, parameters=PLAIN)
    pooled = pool.predict_proba([np.eye(3), np.full((3, 3), np.nan)])
    alone = PRIOR[:, None] * CONFUSIONS[0]
    np.testing.assert_allclose(pooled, (alone / alone.sum(axis=0)).T, atol=0.03)
    np.testing.assert_allclose(pooled.sum(axis=1), 1)
    nobody = pool.predict_proba([np.full((1, 3), np.nan)] * 2)
    assert np.isfinite(nobody).all()


def test_a_strong_penalty_leaves_the_rule_of_bayes_for_independent_labellers(rng):
    truth, answers, _ = planted(rng, 5000)
    prior = np.bincount(truth) / len(truth)
    strong = PoolParameters(penalties=(1e6,), start="product", balance=0)
    pool = LogLinearPool.fit(answers, truth, parameters=strong)
    tables = [rng.dirichlet([2, 2, 2], 50) for _ in range(2)]
    product = tables[0] * tables[1] / prior
    np.testing.assert_allclose(pool.predict_proba(tables), product / product.sum(axis=1, keepdims=True), atol=1e-3)


def test_a_strong_penalty_leaves_the_first_labeller_alone(rng):
    truth, answers, _ = planted(rng, 5000)
    pool = LogLinearPool.fit(answers, truth, parameters=PoolParameters(penalties=(1e6,), balance=0))
    tables = [rng.dirichlet([2, 2, 2], 50) for _ in range(2)]
    np.testing.assert_allclose(pool.predict_proba(tables), tables[0], atol=2e-3)


def test_stretches_that_are_held_out_choose_the_penalty(rng):
    """The second labeller is right on one stretch of five and wrong elsewhere: only a strong penalty is safe then."""
    truth, answers, _ = planted(rng, 5000)
    alone = PRIOR[:, None] * CONFUSIONS[0]
    answers[0] = answers[0] @ (alone / alone.sum(axis=0)).T  # honest as it is
    choice = PoolParameters(penalties=(1e-6, 1e3), balance=0)
    assert LogLinearPool.fit(answers, truth, parameters=choice).penalty == 1e-6
    moody = np.where(np.arange(5000) < 1000, truth, rng.integers(0, 3, 5000))
    told = [answers[0], np.eye(3)[moody]]
    few = PoolParameters(penalties=(1e-6, 1e3), balance=0, n_points=50)
    assert LogLinearPool.fit(told, truth, parameters=few).penalty == 1e3


def test_the_sample_has_rare_classes_whole_and_stands_for_all_points(rng):
    truth = rng.permutation(np.repeat([0, 1, 3], [9000, 900, 20]))
    rows, stands_for = _sample(truth, 300)
    count = np.bincount(truth[rows], minlength=4)
    assert count[3] == 20 and count[2] == 0 and 250 <= count.sum() <= 300 and count[:2].min() >= 120
    np.testing.assert_allclose(np.bincount(truth[rows], stands_for), [9000, 900, 0, 20])
    assert (np.diff(rows) > 0).all()
    everything, ones = _sample(truth, 10_000)
    assert len(everything) == len(truth) and (ones == 1).all()


def test_balance_raises_the_recall_of_rare_classes(rng):
    truth, answers, _ = planted(rng, 30_000)
    recalls = []
    for balance in (0.0, 1.0):
        pool = LogLinearPool.fit(answers, truth, parameters=PoolParameters(penalties=(1e-3,), balance=balance))
        right = pool.predict_proba(answers).argmax(axis=1) == truth
        recalls.append(np.mean([right[truth == c].mean() for c in range(3)]))
    assert recalls[1] > recalls[0] + 0.02


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: LogLinearPool.fit([], [0]), DataError, "at least one labeller"),
        (lambda: LogLinearPool.fit([np.ones((2, 2))], [-1, -1]), DataError, "labelled points to learn from"),
        (lambda: LogLinearPool.fit([np.ones((2, 2))], [0, 2]), DataError, "labels must be below 2, got 2"),
        (
            lambda: LogLinearPool.fit([np.ones((3, 2))], [0, 1]),
            DataError,
            r"labeller 0 must have shape \(2, 2\), got \(3, 2\)",
        ),
        (lambda: LogLinearPool.fit([[[np.nan, 1.0]]], [0]), DataError, "row 0 is NaN in part"),
        (
            lambda: PoolParameters(penalties=(-1,)),
            ParameterError,
            r"penalties must be finite numbers >= 0, got \(-1,\)",
        ),
        (lambda: PoolParameters(penalties=()), ParameterError, r"penalties must be finite numbers >= 0, got \(\)"),
        (lambda: PoolParameters(start="last"), ParameterError, "start must be 'first' or 'product', got 'last'"),
        (lambda: PoolParameters(n_folds=1), ParameterError, "n_folds must be an integer >= 2, got 1"),
        (lambda: PoolParameters(balance=2), ParameterError, r"balance must be in \[0, 1\], got 2"),
        (lambda: PoolParameters(floor=0), ParameterError, r"floor must be in \(0, 0.5\), got 0"),
        (lambda: PoolParameters(n_points=0), ParameterError, "n_points must be an integer >= 1, got 0"),
    ],
)
def test_what_cannot_be_pooled_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()
