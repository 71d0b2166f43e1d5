"""Probabilities of pairs, and machines from plain arrays, against scikit-learn and general optimisers."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import minimize
from sklearn.svm import SVC

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.machines.kernel_machine import KernelMachine, couple_probabilities, fit_sigmoid


def test_sigmoid_is_the_one_with_least_cross_entropy(rng):
    first = rng.random(400) < 0.3
    decisions = np.where(first, 1.0, -0.5) + rng.normal(0, 1.2, 400)
    target = np.where(first, (first.sum() + 1) / (first.sum() + 2), 1 / ((~first).sum() + 2))

    def loss(parameters):
        p = 1 / (1 + np.exp(parameters[0] * decisions + parameters[1]))
        return -(target * np.log(p) + (1 - target) * np.log(1 - p)).sum()

    found = fit_sigmoid(decisions, first)
    best = minimize(loss, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    assert found == pytest.approx(best.x, abs=1e-4) and found[0] < 0


def test_sigmoid_of_separated_classes_stays_finite():
    a, b = fit_sigmoid(np.array([3.0, 4, 5, -3, -4, -5]), np.array([True] * 3 + [False] * 3))
    assert np.isfinite([a, b]).all() and 1 / (1 + np.exp(4 * a + b)) < 0.99  # Platt's targets are not 0 and 1


def test_pairs_of_a_distribution_give_it_back(rng):
    truth = rng.dirichlet(np.ones(6), 50)
    pairs = np.stack([truth[:, i] / (truth[:, i] + truth[:, j]) for i, j in combinations(range(6), 2)], axis=1)
    assert np.abs(couple_probabilities(pairs, 6) - truth).max() < 0.02


def test_pairs_that_contradict_each_other_are_joined_by_least_squares(rng):
    pairs = rng.uniform(0.05, 0.95, (20, 6))
    found = couple_probabilities(pairs, 4)
    assert np.allclose(found.sum(axis=1), 1)
    for row, given in zip(found, pairs, strict=True):
        share = np.zeros((4, 4))
        for (i, j), value in zip(combinations(range(4), 2), given, strict=True):
            share[i, j], share[j, i] = value, 1 - value

        def loss(p, share=share):
            return sum((share[j, i] * p[i] - share[i, j] * p[j]) ** 2 for i in range(4) for j in range(4) if i != j)

        equal = {"type": "eq", "fun": lambda p: p.sum() - 1}
        best = minimize(loss, np.full(4, 0.25), constraints=[equal], bounds=[(0, 1)] * 4, options={"ftol": 1e-12})
        assert loss(row) < loss(best.x) + 1e-3


@pytest.mark.parametrize("n_classes", [2, 3, 5])
def test_decisions_of_a_machine_are_those_of_scikit_learn(rng, n_classes):
    centres = rng.normal(0, 2, (n_classes, 4))
    labels = rng.integers(0, n_classes, 300)
    features = (centres[labels] + rng.normal(0, 1.5, (300, 4))).astype(np.float32)
    shift, scale = features.mean(axis=0), features.std(axis=0)
    model = SVC(C=3.0, gamma=0.3, decision_function_shape="ovo").fit((features - shift) / scale, labels)
    pairs = n_classes * (n_classes - 1) // 2
    machine = KernelMachine.from_svc(model, shift, scale, np.tile([-2.0, 0.0], (pairs, 1)))
    again = KernelMachine.from_arrays(machine.to_arrays())
    expected = model.decision_function((features - shift) / scale).reshape(300, pairs)
    expected = -expected if n_classes == 2 else expected  # it turns the sign for two classes
    assert np.abs(again.decide(features) - expected).max() < 1e-4
    probabilities = again.predict_proba(features)
    assert probabilities.dtype == np.float32 and np.allclose(probabilities.sum(axis=1), 1, atol=1e-6)
    agree = probabilities.argmax(axis=1) == model.predict((features - shift) / scale)
    assert agree.mean() > 0.95  # the vote of the pairs is not always the most probable class


def test_machine_names_bad_input(rng):
    model = SVC(gamma=0.3).fit(rng.random((10, 3)), np.arange(10) % 2)
    machine = KernelMachine.from_svc(model, np.zeros(3), np.ones(3), np.zeros((1, 2)))
    with pytest.raises(DataError, match=r"features .*got \(4, 2\)"):
        machine.decide(np.zeros((4, 2), np.float32))
    with pytest.raises(DataError, match="lack gamma, sigmoids"):
        arrays = machine.to_arrays()
        KernelMachine.from_arrays({name: arrays[name] for name in arrays if name not in ("gamma", "sigmoids")})
