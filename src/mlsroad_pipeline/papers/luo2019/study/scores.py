"""Metrics of Luo et al. 2019, section 4, from class scores of objects."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix

N_THRESHOLDS = 201
"""Number of thresholds of a precision-recall curve, evenly spaced from 0 to 1."""

N_DRAWS = 2000
"""Bootstrap samples of streets per interval."""


def precision_recall(
    scores: NDArray[np.floating], label: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return thresholds, precision and recall as in the paper: an object has every class i with ``|1 - S_i|`` below
    the threshold.

    Equations 14 and 15, averaged over the classes that occur.
    """
    if not len(label):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    thresholds = np.linspace(0.0, 1.0, N_THRESHOLDS)
    taken = np.abs(1.0 - scores)[None] <= thresholds[:, None, None] + 1e-12
    classes = np.unique(label)
    own = label[:, None] == classes
    right = (taken[:, :, classes] & own).sum(axis=1).astype(np.float64)
    named = taken[:, :, classes].sum(axis=1)
    precision = np.divide(right, named, out=np.full(right.shape, np.nan), where=named > 0)
    some = (named > 0).any(axis=1)
    recall = (right / own.sum(axis=0)).mean(axis=1)
    return thresholds[some], np.nanmean(precision[some], axis=1), recall[some]


def area_under(precision: NDArray[np.float64], recall: NDArray[np.float64]) -> float:
    """Return the area under a step curve of rising recall."""
    return float(np.diff(recall, prepend=0.0) @ precision) if len(recall) else float("nan")


def street_confusions(
    label: NDArray[np.integer], predicted: NDArray[np.integer], street: NDArray[np.integer], n_classes: int
) -> dict[int, NDArray[np.int64]]:
    """Return the confusion matrix of each street."""
    return {
        int(s): confusion_matrix(label[street == s], predicted[street == s], n_classes)[:, :n_classes]
        for s in np.unique(street)
    }


def mean_f1(matrices: NDArray[np.number]) -> NDArray[np.float64]:
    """Return the mean F1 over the classes that have objects, for a stack of confusion matrices."""
    counts = np.asarray(matrices, dtype=np.float64)
    hits = np.diagonal(counts, axis1=-2, axis2=-1)
    support, named = counts.sum(axis=-1), counts.sum(axis=-2)
    f1 = np.where(support > 0, 2 * hits / np.maximum(support + named, 1e-12), 0.0)
    present = (support > 0).sum(axis=-1)
    return np.where(present > 0, f1.sum(axis=-1) / np.maximum(present, 1), np.nan)


def weighted_f1(matrix: NDArray[np.integer]) -> float:
    """Return the mean F1 weighted by the number of objects of each class."""
    counts = np.asarray(matrix, dtype=np.float64)
    support = counts.sum(axis=1)
    f1 = 2 * np.diagonal(counts) / np.maximum(support + counts.sum(axis=0), 1e-12)
    return float(f1 @ support / support.sum()) if support.any() else float("nan")


def mean_figures(matrix: NDArray[np.integer]) -> dict[str, float]:
    """Return means over the classes that have objects, and accuracy (equations 14 to 17)."""
    counts = np.asarray(matrix, dtype=np.float64)
    hits, support, named = np.diagonal(counts), counts.sum(axis=1), counts.sum(axis=0)
    seen = support > 0
    if not seen.any():
        return dict.fromkeys(("precision", "recall", "f1", "accuracy"), float("nan"))
    return {
        "precision": float((hits / np.maximum(named, 1))[seen].mean()),
        "recall": float((hits[seen] / support[seen]).mean()),
        "f1": float(mean_f1(counts)),
        "accuracy": float(hits.sum() / counts.sum()),
    }


def paired_interval(
    first: Sequence[NDArray[np.integer]],
    second: Sequence[NDArray[np.integer]],
    *,
    seed: int,
    n_draws: int = N_DRAWS,
    confidence: float = 0.95,
) -> tuple[float, float, float]:
    """Return the difference in mean F1 of two methods and its bootstrap interval.

    Streets, not objects, are sampled with replacement, because objects of a street are not independent. Both methods
    get the same streets, whose confusion matrices are summed.
    """
    one, two = np.stack(first).astype(np.float64), np.stack(second).astype(np.float64)
    n = len(one)
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=n_draws).astype(np.float64)
    apart = mean_f1(np.tensordot(drawn, one, axes=1)) - mean_f1(np.tensordot(drawn, two, axes=1))
    low, high = np.quantile(apart, [0.5 - confidence / 2, 0.5 + confidence / 2])
    return float(mean_f1(one.sum(axis=0)) - mean_f1(two.sum(axis=0))), float(low), float(high)
