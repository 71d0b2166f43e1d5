"""Partition scores against counts by hand and brute force."""

import numpy as np
import pytest
from sklearn.metrics import accuracy_score

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.partition import evaluate_partition

LABELS = np.array([5, 5, 5, 5, 9, 9, 9, 2, 2, 2])
TRUTH = np.array([0, 0, 0, 1, 1, 1, 1, 1, 1, -1])
NEAR = np.stack([np.arange(9), np.arange(1, 10)], axis=1)


def test_counts_by_hand():
    quality = evaluate_partition(LABELS, TRUTH, pairs=[[2, 3], [3, 4], [4, 5], [8, 9]])
    assert quality.n_segments == 3
    assert quality.accuracy_ceiling == 8 / 9  # one point of segment 5 is lost
    assert quality.under_segmentation_error == 2 / 9  # min(3, 1) for label 0 and min(1, 3) for label 1
    assert quality.leakage == 4 / 9
    assert quality.boundary_recall == 0.0  # 2 and 3 differ in truth, not in segment
    moved = evaluate_partition([5, 5, 5, 9, 9, 9, 9, 2, 2, 2], TRUTH, pairs=[[2, 3], [3, 4]])
    assert (moved.boundary_recall, moved.under_segmentation_error, moved.accuracy_ceiling) == (1.0, 0.0, 1.0)


def test_brute_force(rng):
    labels, truth = rng.integers(0, 30, 400), rng.integers(-1, 4, 400)
    xyz = rng.uniform(0, 1, (400, 3))
    apart = np.linalg.norm(xyz[:, None] - xyz, axis=2)
    pairs = np.column_stack([np.repeat(np.arange(400), 5), np.argsort(apart, axis=1)[:, 1:6].ravel()])
    quality = evaluate_partition(labels, truth, pairs=pairs)
    scored = np.flatnonzero(truth >= 0)
    leak = error = best = 0
    for s in np.unique(labels):
        counts = [np.sum((labels == s) & (truth == t)) for t in range(4)]
        best += max(counts)
        for c in counts:
            if c:
                leak += sum(counts) - c
                error += min(c, sum(counts) - c)
    assert quality.accuracy_ceiling == best / len(scored)
    assert quality.under_segmentation_error == error / len(scored)
    assert quality.leakage == leak / len(scored)
    border = kept = 0
    for i, j in pairs:
        if truth[i] >= 0 and truth[j] >= 0:  # unscored points count on neither side
            border += truth[i] != truth[j]
            kept += truth[i] != truth[j] and labels[i] != labels[j]
    assert quality.boundary_recall == kept / border
    majority = [np.bincount(truth[scored][labels[scored] == label]).argmax() for label in labels[scored]]
    assert accuracy_score(truth[scored], majority) == quality.accuracy_ceiling


def test_perfect_and_worst_partition():
    assert evaluate_partition(np.arange(10), TRUTH, pairs=NEAR).boundary_recall == 1.0
    one = evaluate_partition(np.zeros(10, int), np.arange(10) % 2, pairs=NEAR)
    assert (one.boundary_recall, one.accuracy_ceiling, one.leakage) == (0.0, 0.5, 1.0)


def test_nothing_to_score_is_nan():
    nothing = evaluate_partition([1, 2], [-1, -1], pairs=NEAR[:1])
    assert nothing.n_segments == 0 and np.isnan(nothing.accuracy_ceiling) and np.isnan(nothing.leakage)
    assert np.isnan(evaluate_partition([1, 2], [0, 0], pairs=NEAR[:1]).boundary_recall)
    assert np.isnan(evaluate_partition([1], [0], pairs=NEAR[:0]).boundary_recall)


@pytest.mark.parametrize(
    ("labels", "truth", "pairs", "message"),
    [
        (LABELS, TRUTH[:4], NEAR, r"truth must have shape \(10,\), got \(4,\)"),
        (LABELS * 1.0, TRUTH, NEAR, "labels must be integers, got float64"),
        (LABELS, TRUTH * 1.0, NEAR, "truth must be integers, got float64"),
        (LABELS[:, None], TRUTH, NEAR, "labels must have shape"),
        (LABELS, TRUTH, [[0, 10]], "pairs must lie in 0..9, got 0 to 10"),
        (LABELS, TRUTH, [[0.5, 1]], "pairs must be integers"),
    ],
)
def test_bad_input_is_named(labels, truth, pairs, message):
    with pytest.raises(DataError, match=message):
        evaluate_partition(labels, truth, pairs=pairs)
