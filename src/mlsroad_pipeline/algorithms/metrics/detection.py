"""Detections against reference objects: counts at a threshold, the paper's four figures, precision-recall curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.instances import Overlaps
from mlsroad_pipeline.algorithms.metrics.scores import ALL, COLUMNS, DETECTION_METRICS, check_scores


@dataclass(frozen=True)
class DetectionCounts:
    """Right, wrong and missing detections, and what follows from them (Yu et al. 2016, section V-D).

    Attributes
    ----------
    tp, fp, fn : int
        Detections that match an object, detections that do not, objects without one.
    """

    tp: int
    fp: int
    fn: int

    @property
    def precision(self) -> float:
        """TP / (TP + FP); NaN without detections."""
        return _ratio(self.tp, self.tp + self.fp)

    @property
    def recall(self) -> float:
        """TP / (TP + FN); NaN without objects."""
        return _ratio(self.tp, self.tp + self.fn)

    @property
    def quality(self) -> float:
        """TP / (TP + FP + FN); NaN without either."""
        return _ratio(self.tp, self.tp + self.fp + self.fn)

    @property
    def f_score(self) -> float:
        """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); NaN without either."""
        return _ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn)


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def match_detections(
    overlaps: Overlaps, scores: ArrayLike, wanted: ArrayLike, *, iou_threshold: float = 0.5
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Match the detections of one class with the reference objects of that class, the best score first.

    Parameters
    ----------
    overlaps : Overlaps
        Which segments share points with which instances; a detection is a segment.
    scores : array-like of shape (s,)
        Score of each segment of `overlaps` for the class; NaN where it is not detected.
    wanted : array-like of shape (t,), bool
        Whether each instance of `overlaps` is of the class.
    iou_threshold : float, default 0.5
        A detection is right when its points overlap a still unmatched object with an IoU of at least this much.

    Returns
    -------
    order : ndarray of int64, shape (d,)
        Detected segments, the best score first; of equal ones the first segment.
    right : ndarray of bool, shape (d,)
        Whether each matched an object.

    Raises
    ------
    DataError
        If there is not one score per segment and one flag per instance.
    """
    values, objects = np.asarray(scores, dtype=np.float64), np.asarray(wanted, dtype=bool)
    if values.shape != overlaps.segments.shape or objects.shape != overlaps.instances.shape:
        raise DataError(
            f"{len(overlaps.segments)} segments have {values.shape} scores, {len(overlaps.instances)} instances "
            f"{objects.shape} flags"
        )
    order = np.argsort(-values, kind="stable")
    order = order[np.isfinite(values[order])]
    close = np.flatnonzero((overlaps.iou >= iou_threshold) & objects[overlaps.instance])
    candidates: dict[int, list[tuple[float, int]]] = {}
    for pair in close:
        best = (-float(overlaps.iou[pair]), int(overlaps.instance[pair]))
        candidates.setdefault(int(overlaps.segment[pair]), []).append(best)
    taken: set[int] = set()
    right = np.zeros(len(order), dtype=bool)
    for rank, segment in enumerate(order.tolist()):
        free = [instance for _, instance in sorted(candidates.get(segment, [])) if instance not in taken]
        if free:
            taken.add(free[0])
            right[rank] = True
    return order, right


def count_detections(right: ArrayLike, n_objects: int) -> DetectionCounts:
    """Count right, wrong and missing detections.

    Parameters
    ----------
    right : array-like of shape (d,), bool
        Whether each detection matched an object, from `match_detections`.
    n_objects : int
        Number of reference objects of the class.

    Returns
    -------
    DetectionCounts
        The counts.

    Raises
    ------
    DataError
        If more detections are right than there are objects.
    """
    flags = np.asarray(right, dtype=bool)
    tp = int(flags.sum())
    if tp > n_objects:
        raise DataError(f"{tp} detections are right, but there are {n_objects} objects")
    return DetectionCounts(tp, len(flags) - tp, n_objects - tp)


def precision_recall_curve(
    scores: ArrayLike, right: ArrayLike, n_objects: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Follow precision and recall as the threshold on the score falls.

    Parameters
    ----------
    scores : array-like of shape (d,)
        Scores of the detections, in any order; several surveys may be joined.
    right : array-like of shape (d,), bool
        Whether each matched an object.
    n_objects : int
        Number of reference objects, at least 1.

    Returns
    -------
    threshold, precision, recall : ndarray of float64, shape (t,)
        One entry per different score, falling: figures of the detections that score as much or more.

    Raises
    ------
    DataError
        If the lengths differ, there are no objects, or more detections are right than there are objects.
    """
    values, flags = np.asarray(scores, dtype=np.float64), np.asarray(right, dtype=bool)
    if values.shape != flags.shape:
        raise DataError(f"{values.shape} scores for {flags.shape} detections")
    if n_objects < max(1, int(flags.sum())):
        raise DataError(f"{int(flags.sum())} detections are right, but there are {n_objects} objects")
    order = np.argsort(-values, kind="stable")
    hits = np.cumsum(flags[order])
    last = np.flatnonzero(np.append(np.diff(values[order]) != 0, True)) if len(order) else np.zeros(0, np.int64)
    return values[order][last], hits[last] / (last + 1), hits[last] / n_objects


def detection_scores(
    counts: Sequence[DetectionCounts], *, method: str, split: str, classes: Sequence[str]
) -> pd.DataFrame:
    """Turn the counts of each class into the table of scores of one method on one split.

    Parameters
    ----------
    counts : sequence of DetectionCounts
        One per class.
    method : str
        The method's slug.
    split : str
        The split's name.
    classes : sequence of str
        Class names.

    Returns
    -------
    DataFrame
        Rows of `DETECTION_METRICS` per class (support: its objects) and for ``"all"``: means over the classes that have
        objects for the four figures, sums for the counts.

    Raises
    ------
    DataError
        If there is not one name per class, or one of them is ``"all"``.
    """
    if len(counts) != len(classes) or ALL in classes:
        raise DataError(f"{len(counts)} classes are called {', '.join(classes)}; none may be called {ALL!r}")
    rows = [
        (method, split, name, metric, float(getattr(count, metric)), count.tp + count.fn)
        for name, count in zip(classes, counts, strict=True)
        for metric in DETECTION_METRICS
    ]
    present = [count for count in counts if count.tp + count.fn]
    total = sum(count.tp + count.fn for count in counts)
    for metric in DETECTION_METRICS:
        values = np.array([getattr(count, metric) for count in present], dtype=np.float64)
        if metric in ("tp", "fp", "fn"):
            value = float(sum(getattr(count, metric) for count in counts))
        else:
            value = float(values[np.isfinite(values)].mean()) if np.isfinite(values).any() else np.nan
        rows.append((method, split, ALL, metric, value, total))
    return check_scores(pd.DataFrame(rows, columns=list(COLUMNS)))
