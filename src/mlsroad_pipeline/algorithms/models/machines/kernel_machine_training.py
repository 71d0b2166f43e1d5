"""Training of one-against-one support vector machines, with cross-validation for C, gamma and the sigmoids."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from sklearn.metrics import f1_score
from sklearn.svm import SVC

from mlsroad_pipeline.algorithms.models.machines.kernel_machine import Choice, KernelMachine
from mlsroad_pipeline.algorithms.models.machines.pairwise import fit_sigmoid

Folds = Sequence[tuple[NDArray, NDArray]]
"""Training rows and held-out rows of each fold."""


def standardise(features: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean of each feature, and its standard deviation with 1 for constant features."""
    spread = features.std(axis=0)
    return features.mean(axis=0), np.where(spread > 0, spread, 1).astype(np.float32)


def choose_machine(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    folds: Folds,
    *,
    costs: Sequence[float],
    gammas: Sequence[float],
    n_threads: int = 1,
) -> Choice:
    """Return C and gamma with the best mean F1 on held-out samples; ties go to the smaller values.

    The features, float32 (n, d), are standardised. The result does not depend on the threads.
    """
    grid: list[tuple[float, float]] = list(product(sorted(costs), sorted(gammas)))
    run: Any = delayed(_score)
    scores = Parallel(n_jobs=n_threads, prefer="threads")(run(features, labels, folds, c, g) for c, g in grid)
    best = int(np.argmax(scores))
    return Choice(*grid[best], scores[best])


def fit_machine(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    choice: Choice,
    *,
    held_out: NDArray[np.float32],
    held_out_labels: NDArray[np.integer],
    folds: Folds,
) -> KernelMachine:
    """Train a support vector machine, and sigmoids on held-out decision values.

    `features`, float32 (n, d), are not standardised; `held_out`, those of the samples of the folds, are, with the mean
    and standard deviation of `features`.
    """
    shift, scale = standardise(features)
    trained = np.unique(labels).astype(np.int64)
    decisions = _decide_held_out(held_out, held_out_labels, folds, trained, choice.cost, choice.gamma)
    model = SVC(C=choice.cost, gamma=choice.gamma, decision_function_shape="ovo", cache_size=500)
    model.fit((features - shift) / scale, labels)
    return KernelMachine.from_svc(model, shift, scale, _sigmoids(decisions, held_out_labels, trained))


def _decide_held_out(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    folds: Folds,
    trained: NDArray[np.int64],
    cost: float,
    gamma: float,
) -> NDArray[np.float64]:
    """Return the held-out decision values of all pairs; NaN for pairs absent from the training part of a fold."""
    pairs = {pair: k for k, pair in enumerate(combinations(trained.tolist(), 2))}
    out = np.full((len(features), len(pairs)), np.nan)
    for train, test in folds:
        model = SVC(C=cost, gamma=gamma, decision_function_shape="ovo", cache_size=200)
        model.fit(features[train], labels[train])
        values = model.decision_function(features[test])
        known = model.classes_.tolist()
        if len(known) == 2:
            values = -values[:, None]  # scikit-learn's sign for two classes
        columns = np.array([pairs[pair] for pair in combinations(known, 2)])
        out[np.ix_(test, columns)] = values
    return out


def _vote(decisions: NDArray[np.float64], trained: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the class that wins most pairs, the lowest of equal ones."""
    votes = np.zeros((len(decisions), len(trained)), np.int64)
    for k, (i, j) in enumerate(combinations(range(len(trained)), 2)):
        votes[:, i] += decisions[:, k] > 0
        votes[:, j] += decisions[:, k] <= 0
    return trained[votes.argmax(axis=1)]


def _score(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    folds: Folds,
    cost: float,
    gamma: float,
) -> float:
    trained = np.unique(labels).astype(np.int64)
    decisions = _decide_held_out(features, labels, folds, trained, cost, gamma)
    tested = np.concatenate([test for _, test in folds])
    predicted = _vote(decisions[tested], trained)
    return float(f1_score(labels[tested], predicted, average="macro", zero_division=0))


def _sigmoids(
    decisions: NDArray[np.float64], labels: NDArray[np.integer], trained: NDArray[np.int64]
) -> NDArray[np.float64]:
    pairs = list(combinations(trained.tolist(), 2))
    samples = []
    for k, (i, j) in enumerate(pairs):
        rows = np.isfinite(decisions[:, k]) & ((labels == i) | (labels == j))
        samples.append((decisions[rows, k], labels[rows] == i))
    usable = [first.any() and not first.all() for _, first in samples]
    pooled = [sample for sample, good in zip(samples, usable, strict=True) if good] or samples
    shared = fit_sigmoid(np.concatenate([s[0] for s in pooled]), np.concatenate([s[1] for s in pooled]))
    fitted = [fit_sigmoid(*sample) if good else shared for sample, good in zip(samples, usable, strict=True)]
    return np.array(fitted, dtype=np.float64)
