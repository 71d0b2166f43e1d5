"""Queries that speak for and against a class, with weights: a support vector machine whose kernel is the likeness."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

_CHUNK = 4096  # objects that are compared with all that weights were learned from at once


class Weights(NamedTuple):
    """What likenesses to training objects are multiplied with.

    Parameters
    ----------
    chosen : ndarray of int64, shape (q,)
        The training objects that count: the queries.
    values : ndarray of float64, shape (q,)
        Their weights; negative ones speak against the class.
    offset : float
        What is added to the weighted sum.
    """

    chosen: NDArray[np.int64]
    values: NDArray[np.float64]
    offset: float


def weigh(alike: NDArray[np.float64], weights: NDArray[np.float64], offset: float) -> NDArray[np.float64]:
    """Return the score of objects: the logistic function of the weighted sum of their likenesses to queries.

    Parameters
    ----------
    alike : ndarray of float64, shape (q, n)
        Likeness of each object to each query.
    weights : ndarray of float64, shape (q,)
        Of the queries.
    offset : float
        Is added.

    Returns
    -------
    ndarray of float64, shape (n,)
        In (0, 1).
    """
    return np.asarray(expit(weights @ alike + offset), dtype=np.float64)


def learn_weights(alike: NDArray[np.float64], truth: NDArray[np.bool_], penalty: float) -> Weights:
    """Learn which training objects are queries, and their weights.

    Parameters
    ----------
    alike : ndarray of float64, shape (n, n)
        Likeness of the training objects to each other.
    truth : ndarray of bool, shape (n,)
        Whether each is of the class; some are, and some are not.
    penalty : float
        Of training objects on the wrong side, C of the support vector machine.

    Returns
    -------
    Weights
        Its support vectors.
    """
    from sklearn.svm import SVC  # noqa: PLC0415  detection does without

    machine = SVC(C=penalty, kernel="precomputed").fit(alike, truth)
    return Weights(
        machine.support_.astype(np.int64), machine.dual_coef_[0].astype(np.float64), float(machine.intercept_[0])
    )


@dataclass(frozen=True)
class Committee:
    """Machines of a class, each of which has not seen some scenes.

    Attributes
    ----------
    weights : ndarray of float64, shape (rounds, folds, n)
        Weight of each training object in each machine; all 0 where there is none, as the other folds hold no object of
        the class, or nothing else.
    offsets : ndarray of float64, shape (rounds, folds)
        What is added to the weighted sums.
    present : ndarray of bool, shape (rounds, folds)
        Whether there is a machine.
    """

    weights: NDArray[np.float64]
    offsets: NDArray[np.float64]
    present: NDArray[np.bool_]

    def mean(self) -> Weights | None:
        """Return the mean of the machines, which is a machine itself; None where there is none."""
        if not self.present.any():
            return None
        weights = self.weights[self.present].mean(axis=0)
        chosen = np.flatnonzero(weights)
        return Weights(chosen, weights[chosen], float(self.offsets[self.present].mean()))


def train_committee(
    alike: NDArray[np.float64], truth: NDArray[np.bool_], folds: NDArray[np.integer], *, penalty: float
) -> Committee:
    """Learn weights from all folds but one, for each fold of each round.

    Parameters
    ----------
    alike : ndarray of float64, shape (n, n)
        Likeness of the training objects to each other.
    truth : ndarray of bool, shape (n,)
        Whether each is of the class.
    folds : ndarray of int, shape (rounds, n)
        Fold of each object in each round.
    penalty : float
        See `learn_weights`.

    Returns
    -------
    Committee
        The machines.
    """
    n_rounds, n_folds = len(folds), int(folds.max(initial=-1)) + 1
    weights, offsets = np.zeros((n_rounds, n_folds, len(truth))), np.zeros((n_rounds, n_folds))
    present = np.zeros((n_rounds, n_folds), np.bool_)
    for r, f in np.ndindex(n_rounds, n_folds):
        rest = np.flatnonzero(folds[r] != f)
        mine = truth[rest]
        if mine.any() and not mine.all():
            found = learn_weights(alike[np.ix_(rest, rest)], mine, penalty)
            weights[r, f, rest[found.chosen]], offsets[r, f] = found.values, found.offset
            present[r, f] = True
    return Committee(weights, offsets, present)


def held_out_scores(
    committees: Sequence[Committee],
    across: Callable[[NDArray[np.int64]], NDArray[np.float64]],
    folds: NDArray[np.integer],
) -> NDArray[np.float64]:
    """Score objects by the machines that have not seen their scene.

    Parameters
    ----------
    committees : sequence of Committee
        The machines of each class.
    across : callable
        Gives the likeness of objects to all that weights were learned from, (n, chosen).
    folds : ndarray of int, shape (rounds, m)
        Fold of each object in each round.

    Returns
    -------
    ndarray of float64, shape (m, classes)
        The logistic function of the mean over rounds; 0 where no round has a machine that has not seen the object.
    """
    scores = np.zeros((folds.shape[1], len(committees)))
    for start in range(0, folds.shape[1], _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, folds.shape[1]))
        alike = across(rows)
        for label, each in enumerate(committees):
            total, count = np.zeros(len(rows)), np.zeros(len(rows))
            for r, f in np.argwhere(each.present):
                here = folds[r, rows] == f
                total[here] += each.weights[r, f] @ alike[:, here] + each.offsets[r, f]
                count += here
            known = count > 0
            scores[rows[known], label] = expit(total[known] / count[known])
    return scores


def assign_folds(scenes: NDArray, n_folds: int, seed: int) -> NDArray[np.int64]:
    """Divide scenes into folds at random.

    Parameters
    ----------
    scenes : ndarray of shape (n,)
        Scene of each training object.
    n_folds : int
        Folds at most.
    seed : int
        Of the draw.

    Returns
    -------
    ndarray of int64, shape (n,)
        Fold of each object; objects of one scene are in one fold.
    """
    names, of_scene = np.unique(scenes, return_inverse=True)
    order = np.random.default_rng(seed).permutation(len(names))
    place = np.empty(len(names), np.int64)
    place[order] = np.arange(len(names)) % n_folds
    return place[of_scene.ravel()]
