"""Queries that speak for and against a class, with weights: a support vector machine whose kernel is the likeness."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit


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


def held_out_scores(
    alike: NDArray[np.float64],
    across: Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.float64]],
    truth: NDArray[np.integer],
    folds: tuple[NDArray[np.integer], NDArray[np.integer]],
    *,
    n_classes: int,
    penalty: float,
) -> NDArray[np.float64]:
    """Score the objects of each fold by weights learned from the other folds.

    Parameters
    ----------
    alike : ndarray of float64, shape (n, n)
        Likeness of the objects that weights are learned from to each other.
    across : callable
        Gives the likeness of some of all objects (second argument) to some of those learned from (first).
    truth : ndarray of int, shape (n,)
        Class of each object that is learned from; -1 for others.
    folds : tuple of ndarray of int, shapes (n,) and (m,)
        Fold of each object that is learned from, and of each of all.
    n_classes : int
        Number of classes.
    penalty : float
        See `learn_weights`.

    Returns
    -------
    ndarray of float64, shape (m, n_classes)
        Scores; 0 where the other folds hold no object of the class, or nothing else.
    """
    of_known, of_all = folds
    scores = np.zeros((len(of_all), n_classes))
    for number in np.unique(of_all):
        here, rest = np.flatnonzero(of_all == number), np.flatnonzero(of_known != number)
        if len(rest) == 0:
            continue
        seen, own = across(rest, here), alike[np.ix_(rest, rest)]
        for label in range(n_classes):
            mine = truth[rest] == label
            if mine.any() and not mine.all():
                found = learn_weights(own, mine, penalty)
                scores[here, label] = weigh(seen[found.chosen], found.values, found.offset)
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
