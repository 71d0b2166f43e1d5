"""Thresholds on the scores of detectors: the best on training objects, and which class an object passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.classes import IGNORE
from mlsroad_pipeline.algorithms.metrics.detection import precision_recall_curve


def best_threshold(scores: NDArray[np.floating], truth: NDArray[np.bool_]) -> tuple[float, float]:
    """Find the threshold on a score with the best F-score.

    Parameters
    ----------
    scores : ndarray of float, shape (n,)
        Score of each training object, which it must not owe to itself. 0 is no likeness at all and never detected.
    truth : ndarray of bool, shape (n,)
        Whether each is of the class.

    Returns
    -------
    f_score : float
        The best F-score.
    threshold : float
        The middle of the scores between which it is reached; where no object of the class scores, anything above 0;
        where no object is of the class, infinity.
    """
    if not truth.any():
        return 0.0, float("inf")
    some = scores > 0
    if not (some & truth).any():
        return 0.0, float(np.nextafter(0.0, 1.0))
    levels, precision, recall = precision_recall_curve(scores[some], truth[some], int(truth.sum()))
    with np.errstate(invalid="ignore"):
        f_score = np.where(precision + recall > 0, 2 * precision * recall / (precision + recall), 0.0)
    k = int(np.argmax(f_score))
    below = levels[k + 1] if k + 1 < len(levels) else 0.0
    return float(f_score[k]), float(0.5 * (levels[k] + below))


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
