"""Thresholds on the scores of detectors: the best on training objects, and which class an object passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE


def object_weights(labels: NDArray[np.integer], prevalence: NDArray[np.floating] | None) -> NDArray[np.float64]:
    """Weigh training objects so that classes are as frequent as where a detector is used.

    Parameters
    ----------
    labels : ndarray of int, shape (n,)
        Class of each object, -1 for others.
    prevalence : ndarray of float, shape (c,), or None
        Factor of each class, see `DetectionParameters.prevalence`; None stands for 1.

    Returns
    -------
    ndarray of float64, shape (n,)
        Weights; 1 for others.
    """
    weights = np.ones(len(labels))
    if prevalence is not None:
        wanted = labels >= 0
        weights[wanted] = np.asarray(prevalence, dtype=np.float64)[labels[wanted]]
    return weights


def training_weights(scenes: Sequence[Mapping[str, Any]], prevalence: NDArray[np.floating]) -> NDArray[np.float64]:
    """Weigh the objects that training scenes own.

    Parameters
    ----------
    scenes : sequence of mapping
        What `object_classes` gave for each scene: ``label`` and ``own``. A scene may have a ``weight`` too, 0 or more,
        by which all its objects count, 1 by default: with 0 they are learned from, and have no say in thresholds. That
        is for scenes which show far more of what is easily mistaken than there is where a detector is used.
    prevalence : ndarray of float, shape (c,)
        Factor of each class, see `DetectionParameters.prevalence`.

    Returns
    -------
    ndarray of float64
        One weight per object, scene by scene.
    """
    own = [found["label"][found["own"]] for found in scenes]
    each = [float(found.get("weight", 1.0)) for found in scenes]
    return np.concatenate([w * object_weights(labels, prevalence) for labels, w in zip(own, each, strict=True)])


def best_threshold(
    scores: NDArray[np.floating], truth: NDArray[np.bool_], weights: NDArray[np.floating] | None = None
) -> tuple[float, float]:
    """Find the threshold on a score with the best F-score.

    Parameters
    ----------
    scores : ndarray of float, shape (n,)
        Score of each training object, which it must not owe to itself. 0 is no likeness at all and never detected.
    truth : ndarray of bool, shape (n,)
        Whether each is of the class.
    weights : ndarray of float, shape (n,), optional
        How often each object counts, once by default; 0 leaves it out.

    Returns
    -------
    f_score : float
        The best F-score.
    threshold : float
        The middle of the scores between which it is reached; where no object of the class scores, anything above 0;
        where no object that counts is of the class, infinity.
    """
    counted = np.ones(len(scores)) if weights is None else np.asarray(weights, dtype=np.float64)
    scores, truth, counted = scores[counted > 0], truth[counted > 0], counted[counted > 0]
    if not truth.any():
        return 0.0, float("inf")
    order = np.argsort(-scores, kind="stable")
    order = order[scores[order] > 0]
    right = counted[order] * truth[order]
    if not right.any():
        return 0.0, float(np.nextafter(0.0, 1.0))
    levels = scores[order].astype(np.float64)
    last = np.flatnonzero(np.append(np.diff(levels) != 0, True))  # equal scores pass together
    f_score = 2 * np.cumsum(right)[last] / (counted[truth].sum() + np.cumsum(counted[order])[last])
    k = int(np.argmax(f_score))
    below = levels[last[k + 1]] if k + 1 < len(last) else 0.0
    return float(f_score[k]), float(0.5 * (levels[last[k]] + below))


def detect_by_thresholds(
    scores: NDArray[np.floating], thresholds: NDArray[np.floating]
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give each object the class whose threshold its score passes.

    Parameters
    ----------
    scores : ndarray of float, shape (n, c)
        Score of each class.
    thresholds : ndarray of float, shape (c,)
        Score from which an object is detected.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        The class that passes its threshold by the largest factor; -1 where none does.
    scores : ndarray of float32, shape (n,)
        Score of that class; 0 for none.
    """
    best = (scores / np.maximum(thresholds, 1e-12)).argmax(axis=1)
    found = scores[np.arange(len(scores)), best]
    passed = (found >= thresholds[best]) & (found > 0)
    return np.where(passed, best, IGNORE).astype(np.int16), np.where(passed, found, 0.0).astype(np.float32)
