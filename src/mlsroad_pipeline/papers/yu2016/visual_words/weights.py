"""Weights of queries for and against a class: support vector machines whose kernel is the similarity."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

_CHUNK = 4096  # objects compared with the training objects at once


class Weights(NamedTuple):
    """Weights of the similarities to training objects."""

    chosen: NDArray[np.int64]  # Indices of the queries among the training objects
    values: NDArray[np.float64]  # Their weights; negative for counterexamples
    offset: float  # Offset of the weighted sum


def weigh(similarities: NDArray[np.float64], weights: NDArray[np.float64], offset: float) -> NDArray[np.float64]:
    """Return the score of objects: the logistic function of the weighted sum of their similarities to queries."""
    return np.asarray(expit(weights @ similarities + offset), dtype=np.float64)


def learn_weights(similarities: NDArray[np.float64], truth: NDArray[np.bool_], penalty: float) -> Weights:
    """Fit a support vector machine; its support vectors are the queries."""
    from sklearn.svm import SVC  # noqa: PLC0415  not needed for detection

    machine = SVC(C=penalty, kernel="precomputed").fit(similarities, truth)
    return Weights(
        machine.support_.astype(np.int64), machine.dual_coef_[0].astype(np.float64), float(machine.intercept_[0])
    )


@dataclass(frozen=True)
class Committee:
    """Support vector machines of a class, each trained without one fold of the scenes."""

    # Weight of each training object in each machine. All 0 where there is no machine because the other folds contain no
    # object of the class or no other object.
    weights: NDArray[np.float64]
    offsets: NDArray[np.float64]  # Offsets of the weighted sums
    present: NDArray[np.bool_]  # Whether there is a machine

    def mean(self) -> Weights | None:
        """Return the mean of the machines; None where there is none."""
        if not self.present.any():
            return None
        weights = self.weights[self.present].mean(axis=0)
        chosen = np.flatnonzero(weights)
        return Weights(chosen, weights[chosen], float(self.offsets[self.present].mean()))


def train_committee(
    similarities: NDArray[np.float64], truth: NDArray[np.bool_], folds: NDArray[np.integer], *, penalty: float
) -> Committee:
    """Fit one machine per fold of each round to all other folds."""
    n_rounds, n_folds = len(folds), int(folds.max(initial=-1)) + 1
    weights, offsets = np.zeros((n_rounds, n_folds, len(truth))), np.zeros((n_rounds, n_folds))
    present = np.zeros((n_rounds, n_folds), np.bool_)
    for r, f in np.ndindex(n_rounds, n_folds):
        rest = np.flatnonzero(folds[r] != f)
        mine = truth[rest]
        if mine.any() and not mine.all():
            learned = learn_weights(similarities[np.ix_(rest, rest)], mine, penalty)
            weights[r, f, rest[learned.chosen]], offsets[r, f] = learned.values, learned.offset
            present[r, f] = True
    return Committee(weights, offsets, present)


def held_out_scores(
    committees: Sequence[Committee],
    across: Callable[[NDArray[np.int64]], NDArray[np.float64]],
    folds: NDArray[np.integer],
) -> NDArray[np.float64]:
    """Score objects by the machines that were trained without their scenes."""
    scores = np.zeros((folds.shape[1], len(committees)))
    for start in range(0, folds.shape[1], _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, folds.shape[1]))
        similarities = across(rows)
        for label, each in enumerate(committees):
            total, count = np.zeros(len(rows)), np.zeros(len(rows))
            for r, f in np.argwhere(each.present):
                here = folds[r, rows] == f
                total[here] += each.weights[r, f] @ similarities[:, here] + each.offsets[r, f]
                count += here
            known = count > 0
            scores[rows[known], label] = expit(total[known] / count[known])
    return scores


def assign_folds(scenes: NDArray, n_folds: int, seed: int) -> NDArray[np.int64]:
    """Divide scenes into random folds."""
    names, of_scene = np.unique(scenes, return_inverse=True)
    order = np.random.default_rng(seed).permutation(len(names))
    place = np.empty(len(names), np.int64)
    place[order] = np.arange(len(names)) % n_folds
    return place[of_scene.ravel()]
