"""Score thresholds of detectors: choice on training objects, choice of queries, and detection."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE


def object_weights(labels: NDArray[np.integer], prevalence: NDArray[np.floating] | None) -> NDArray[np.float64]:
    """Weigh training objects by the prevalence of their classes in the target survey."""
    weights = np.ones(len(labels))
    if prevalence is not None:
        wanted = labels >= 0
        weights[wanted] = np.asarray(prevalence, dtype=np.float64)[labels[wanted]]
    return weights


def best_threshold(
    scores: NDArray[np.floating], truth: NDArray[np.bool_], weights: NDArray[np.floating] | None = None
) -> tuple[float, float]:
    """Find the threshold on a score with the best F-score."""
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
    last = np.flatnonzero(np.append(np.diff(levels) != 0, True))  # equal scores share a threshold
    f_score = 2 * np.cumsum(right)[last] / (counted[truth].sum() + np.cumsum(counted[order])[last])
    k = int(np.argmax(f_score))
    below = levels[last[k + 1]] if k + 1 < len(last) else 0.0
    return float(f_score[k]), float(0.5 * (levels[last[k]] + below))


def choose_queries(
    similarity: NDArray[np.float64], candidates: NDArray[np.int64], truth: NDArray[np.bool_], *, max_queries: int
) -> tuple[list[int], float, float]:
    """Select the queries of a class greedily: each is the candidate that raises the F-score most."""
    similarity = similarity.copy()
    similarity[np.arange(len(candidates)), candidates] = 0.0
    best = np.zeros(similarity.shape[1])
    chosen: list[int] = []
    reached, threshold = -1.0, float("inf")
    while len(chosen) < min(max_queries, len(candidates)):
        trials = [
            (-1.0, float("inf")) if k in chosen else best_threshold(np.maximum(best, row), truth)
            for k, row in enumerate(similarity)
        ]
        k = int(np.argmax([value for value, _ in trials]))
        if trials[k][0] <= reached:
            break
        reached, threshold = trials[k]
        chosen.append(k)
        best = np.maximum(best, similarity[k])
    return chosen, threshold, reached


def detect_by_thresholds(
    scores: NDArray[np.floating], thresholds: NDArray[np.floating]
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Assign each object to the class whose threshold its score exceeds by the largest factor."""
    best = (scores / np.maximum(thresholds, 1e-12)).argmax(axis=1)
    score = scores[np.arange(len(scores)), best]
    passed = (score >= thresholds[best]) & (score > 0)
    return np.where(passed, best, IGNORE).astype(np.int16), np.where(passed, score, 0.0).astype(np.float32)
