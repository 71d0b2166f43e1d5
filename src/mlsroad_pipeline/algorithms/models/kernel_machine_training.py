"""Training one-against-one machines with a Gaussian kernel: C, gamma and the sigmoids come from cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from sklearn.metrics import f1_score
from sklearn.svm import SVC

from mlsroad_pipeline.algorithms.models.kernel_machine import Choice, KernelMachine
from mlsroad_pipeline.algorithms.models.pairwise import fit_sigmoid

Folds = Sequence[tuple[NDArray, NDArray]]
"""Rows to train on and rows that are held out, of each fold."""


def standardise(features: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean and the spread of each feature.

    Parameters
    ----------
    features : ndarray of float32, shape (n, d)
        The features.

    Returns
    -------
    shift, scale : ndarray of float32, shape (d,)
        Means and standard deviations, 1 where a feature is constant.
    """
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
    """Choose C and gamma: those with the best mean F1 on held-out samples, of equal ones the smaller.

    Parameters
    ----------
    features : ndarray of float32, shape (n, d)
        Scaled features.
    labels : ndarray of int, shape (n,)
        Their classes.
    folds : sequence of (rows, rows)
        The folds.
    costs, gammas : sequence of float
        The values to choose from.
    n_threads : int, default 1
        Threads; the choice does not depend on them.

    Returns
    -------
    Choice
        The best.
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
    """Train a machine, with sigmoids that are fitted to its decisions on held-out samples.

    A pair of classes that never meets among these takes the sigmoid of all pairs together.

    Parameters
    ----------
    features : ndarray of float32, shape (n, d)
        Features as they are.
    labels : ndarray of int, shape (n,)
        Their classes.
    choice : Choice
        C and gamma.
    held_out : ndarray of float32, shape (m, d)
        Features of the samples of the folds, scaled by `standardise` of `features`.
    held_out_labels : ndarray of int, shape (m,)
        Their classes.
    folds : sequence of (rows, rows)
        The folds.

    Returns
    -------
    KernelMachine
        The machine.
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
    """Return the decisions of all pairs on held-out patches, NaN for pairs that a fold's machine does not know."""
    pairs = {pair: k for k, pair in enumerate(combinations(trained.tolist(), 2))}
    out = np.full((len(features), len(pairs)), np.nan)
    for train, test in folds:
        model = SVC(C=cost, gamma=gamma, decision_function_shape="ovo", cache_size=200)
        model.fit(features[train], labels[train])
        found = model.decision_function(features[test])
        known = model.classes_.tolist()
        if len(known) == 2:
            found = -found[:, None]  # scikit-learn's sign for two classes
        columns = np.array([pairs[pair] for pair in combinations(known, 2)])
        out[np.ix_(test, columns)] = found
    return out


def _vote(decisions: NDArray[np.float64], trained: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the class with most won pairs, of equal ones the lowest."""
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
    found = _vote(decisions[tested], trained)
    return float(f1_score(labels[tested], found, average="macro", zero_division=0))


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
