"""Confusion matrix and the scores derived from it."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least

_CHUNK = 1 << 20


@njit(cache=True)
def _count(truth, predicted, matrix):  # type: ignore[no-untyped-def]  # numba infers the types
    """Add points to a matrix whose last column is "unlabelled"; return the first invalid row, or -1."""
    n_classes = matrix.shape[0]
    for i in range(truth.size):
        t = truth[i]
        p = predicted[i]
        if t < -1 or t >= n_classes or p < -1 or p >= n_classes:
            return i
        if t >= 0:
            matrix[t, p if p >= 0 else n_classes] += 1
    return -1


def confusion_matrix(truth: ArrayLike, predicted: ArrayLike, n_classes: int) -> NDArray[np.int64]:
    """Count points by true and predicted class.

    The matrix of several scenes is the sum of their matrices.

    Parameters
    ----------
    truth : array-like of int, shape (n,)
        True labels 0 to ``n_classes - 1``; points labelled -1 are ignored.
    predicted : array-like of int, shape (n,)
        Predicted labels 0 to ``n_classes - 1``; -1 is "unlabelled", which is wrong if the truth is known.
    n_classes : int
        Number of classes C of the scheme.

    Returns
    -------
    ndarray of int64, shape (n_classes, n_classes + 1)
        Row: true class. Column: predicted class; the last column counts the unlabelled points.

    Raises
    ------
    ParameterError
        If `n_classes` is below 1.
    DataError
        If the arrays are not one-dimensional, of integers and of one length, or if a label is outside -1 to
        ``n_classes - 1``.

    Examples
    --------
    >>> confusion_matrix([0, 0, 1, -1], [0, 1, -1, 0], 2)
    array([[1, 1, 0],
           [0, 0, 1]])
    """
    check_at_least(n_classes, 1, "n_classes")
    labels = {"truth": np.asarray(truth), "predicted": np.asarray(predicted)}
    for name, values in labels.items():
        integral = np.issubdtype(values.dtype, np.integer) or values.size == 0
        if values.ndim != 1 or not integral:
            raise DataError(f"{name} labels must be integers of shape (n,), got {values.dtype} {values.shape}")
    t, p = labels["truth"], labels["predicted"]
    if len(t) != len(p):
        raise DataError(f"{len(t)} true labels but {len(p)} predicted ones")
    matrix = np.zeros((n_classes, n_classes + 1), dtype=np.int64)
    for start in range(0, len(t), _CHUNK):
        rows = slice(start, start + _CHUNK)
        bad = _count(t[rows].astype(np.int64), p[rows].astype(np.int64), matrix)
        if bad >= 0:
            i = start + bad
            raise DataError(f"labels must be in -1..{n_classes - 1}: row {i} has truth {t[i]}, predicted {p[i]}")
    return matrix


@dataclass(frozen=True)
class LabellingScores:
    """Scores of labels; undefined values are NaN.

    Parameters
    ----------
    precision, recall, f1, iou : ndarray of float64, shape (C,)
        Scores per class. Precision is undefined for a class never predicted, recall for a class without points, F1 and
        IoU if both hold.
    support : ndarray of int64, shape (C,)
        True points of each class.
    overall_accuracy : float
        Share of correctly labelled points.
    kappa : float
        Cohen's kappa: agreement beyond chance.
    mean_f1, mean_iou : float
        Means over the classes that have support.
    """

    precision: NDArray[np.float64]
    recall: NDArray[np.float64]
    f1: NDArray[np.float64]
    iou: NDArray[np.float64]
    support: NDArray[np.int64]
    overall_accuracy: float
    kappa: float
    mean_f1: float
    mean_iou: float


def _ratio(numerator: ArrayLike, denominator: ArrayLike) -> NDArray[np.float64]:
    """Return the ratio, NaN for a denominator of 0."""
    top, bottom = np.asarray(numerator, dtype=np.float64), np.asarray(denominator, dtype=np.float64)
    return np.divide(top, bottom, out=np.full(np.broadcast(top, bottom).shape, np.nan), where=bottom != 0)


def scores(matrix: NDArray[np.integer]) -> LabellingScores:
    """Return precision, recall, F1, IoU, overall accuracy, kappa and means of a confusion matrix.

    With TP on the diagonal, FN the rest of the row (unlabelled points included) and FP the rest of the column:
    precision TP / (TP + FP), recall TP / (TP + FN), F1 2 TP / (2 TP + FP + FN), IoU TP / (TP + FP + FN).

    Parameters
    ----------
    matrix : ndarray of int, shape (C, C) or (C, C + 1)
        A matrix of `confusion_matrix`, or a square one without unlabelled points.

    Returns
    -------
    LabellingScores
        The scores; all NaN for a matrix of zeros.

    Raises
    ------
    DataError
        If the matrix has another shape or negative counts.

    Examples
    --------
    >>> result = scores(np.array([[3, 1], [0, 4]]))
    >>> result.recall.tolist(), round(result.overall_accuracy, 3)
    ([0.75, 1.0], 0.875)
    """
    counts = np.asarray(matrix)
    if counts.ndim != 2 or counts.shape[1] - counts.shape[0] not in (0, 1) or counts.size == 0:
        raise DataError(f"a confusion matrix has shape (C, C) or (C, C + 1), got {counts.shape}")
    if (counts < 0).any():
        raise DataError(f"a confusion matrix holds counts, got {counts.min()}")
    n_classes = counts.shape[0]
    hits = np.diagonal(counts).astype(np.float64)
    support = counts.sum(axis=1).astype(np.int64)
    named = counts.sum(axis=0)[:n_classes].astype(np.float64)
    f1 = _ratio(2 * hits, support + named)
    iou = _ratio(hits, support + named - hits)
    total = float(support.sum())
    accuracy = float(_ratio(hits.sum(), total))
    chance = float(_ratio((support * named).sum(), total * total))
    scored = support > 0
    return LabellingScores(
        precision=_ratio(hits, named),
        recall=_ratio(hits, support),
        f1=f1,
        iou=iou,
        support=support,
        overall_accuracy=accuracy,
        kappa=float(_ratio(accuracy - chance, 1 - chance)),
        mean_f1=float(f1[scored].mean()) if scored.any() else float("nan"),
        mean_iou=float(iou[scored].mean()) if scored.any() else float("nan"),
    )
