"""Scores of detections: matching with reference objects, counts, scores of the paper, precision-recall curves."""

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
    """True positives, false positives and false negatives, and their scores (Yu et al. 2016, section V-D).

    Attributes
    ----------
    tp, fp, fn : int
        Detections that match an object, detections without an object, objects without a detection.
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
        """TP / (TP + FP + FN); NaN without detections and objects."""
        return _ratio(self.tp, self.tp + self.fp + self.fn)

    @property
    def f_score(self) -> float:
        """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); NaN without detections and objects."""
        return _ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn)


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def match_detections(
    overlaps: Overlaps, scores: ArrayLike, wanted: ArrayLike, *, iou_threshold: float = 0.5
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Match the detections of a class with its reference objects greedily, highest score first.

    A segment without a score is not a detection. Return the detected segments by descending score, ties by number, and
    whether each matches an object.
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
    """Count true positives, false positives and false negatives."""
    flags = np.asarray(right, dtype=bool)
    tp = int(flags.sum())
    if tp > n_objects:
        raise DataError(f"{tp} detections are right, but there are {n_objects} objects")
    return DetectionCounts(tp, len(flags) - tp, n_objects - tp)


def precision_recall_curve(
    scores: ArrayLike, right: ArrayLike, n_objects: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the distinct scores, descending, and precision and recall of the detections with at least each score."""
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
    """Return the table of scores of one method on one split from the counts of each class.

    Parameters
    ----------
    counts : sequence of DetectionCounts
        Counts of each class.
    method : str
        Slug of the method.
    split : str
        Name of the split.
    classes : sequence of str
        Class names.

    Returns
    -------
    DataFrame
        Rows of `DETECTION_METRICS` per class (support: its objects) and for ``"all"``: means of the four scores over
        the classes with objects, sums of the counts.

    Raises
    ------
    DataError
        If the number of names differs from that of counts, or a class is called ``"all"``.
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
