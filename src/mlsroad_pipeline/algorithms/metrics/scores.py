"""Table of scores of all evaluated methods: `method,split,class,metric,value,support`."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.confusion import LabellingScores, scores

COLUMNS = ("method", "split", "class", "metric", "value", "support")
"""Columns of the table, in order."""

ALL = "all"
"""Value of `class` for scores over all classes."""

CLASS_METRICS = ("precision", "recall", "f1", "iou")
OVERALL_METRICS = ("overall_accuracy", "kappa", "mean_f1", "mean_iou")
RECOGNITION_METRICS = (*OVERALL_METRICS, "weighted_f1")
DETECTION_METRICS = ("precision", "recall", "quality", "f_score", "tp", "fp", "fn")
CALIBRATION_METRICS = ("calibration_error", "auroc", "brier_score")
METRICS = tuple(dict.fromkeys((*CLASS_METRICS, *RECOGNITION_METRICS, *DETECTION_METRICS, *CALIBRATION_METRICS)))
"""All metrics of labels and their confidences, recognitions and detections."""

_ILLEGAL = re.compile(r"[^\w.\- /]")


def labelling_scores(
    matrix: NDArray[np.integer],
    *,
    method: str,
    split: str,
    classes: Sequence[str],
    given: Sequence[str] | None = None,
) -> pd.DataFrame:
    """Return the table of scores of one method on one split from a confusion matrix.

    Classes that are not in `given` cannot be predicted: they are NaN and excluded from means over classes; their points
    count in overall accuracy and kappa.
    """
    figures = scores(matrix)
    if len(classes) != len(figures.support):
        raise DataError(f"{len(classes)} class names for a confusion matrix of {len(figures.support)} classes")
    if given is not None:
        figures = _of_given(figures, classes, given)
    rows = [
        (method, split, name, metric, float(getattr(figures, metric)[label]), int(figures.support[label]))
        for label, name in enumerate(classes)
        for metric in CLASS_METRICS
    ]
    total = int(figures.support.sum())
    rows += [(method, split, ALL, metric, float(getattr(figures, metric)), total) for metric in OVERALL_METRICS]
    if ALL in classes:
        raise DataError(f"no class may be called {ALL!r}: it stands for all classes together")
    return check_scores(pd.DataFrame(rows, columns=list(COLUMNS)))


def recognition_scores(matrix: NDArray[np.integer], *, method: str, split: str, classes: Sequence[str]) -> pd.DataFrame:
    """Return the table of scores of one method on one split from a confusion matrix of objects.

    Class ``"all"`` also has ``weighted_f1``, weighted by support: the published score for the Sydney Urban Objects
    (Maturana and Scherer 2015).
    """
    table = labelling_scores(matrix, method=method, split=split, classes=classes)
    figures = scores(matrix)
    seen = figures.support > 0
    total = int(figures.support.sum())
    mean = float(np.average(figures.f1[seen], weights=figures.support[seen])) if total else float("nan")
    row = pd.DataFrame([(method, split, ALL, "weighted_f1", mean, total)], columns=list(COLUMNS))
    return check_scores(pd.concat([table, row], ignore_index=True))


def _of_given(figures: LabellingScores, classes: Sequence[str], given: Sequence[str]) -> LabellingScores:
    """Return the scores without the classes that a method cannot predict."""
    unknown = sorted(set(given) - set(classes))
    if unknown:
        raise DataError(f"{', '.join(unknown)} cannot be given: the classes are {', '.join(classes)}")
    predictable = np.array([name in given for name in classes])
    precision, recall, f1, iou = (np.where(predictable, getattr(figures, metric), np.nan) for metric in CLASS_METRICS)
    scored = predictable & (figures.support > 0)
    mean_f1, mean_iou = (float(v[scored].mean()) if scored.any() else float("nan") for v in (f1, iou))
    return replace(figures, precision=precision, recall=recall, f1=f1, iou=iou, mean_f1=mean_f1, mean_iou=mean_iou)


def check_scores(frame: pd.DataFrame, *, source: str = "scores") -> pd.DataFrame:
    """Return a table of scores in its fixed types; `DataError` if columns, names, values or supports are wrong."""
    if tuple(frame.columns) != COLUMNS:
        raise DataError(f"{source}: columns must be {','.join(COLUMNS)}, got {','.join(map(str, frame.columns))}")
    table = frame.reset_index(drop=True).copy()
    keys = list(COLUMNS[:4])
    for column in keys:
        absent = table[column].isna() | (table[column].astype(str) == "")
        if absent.any():
            raise DataError(f"{source}: row {int(np.argmax(absent))} has no {column}")
        table[column] = table[column].astype(str).astype(object)
    unknown = table.loc[~table["metric"].isin(METRICS), "metric"]
    if len(unknown):
        raise DataError(f"{source}: unknown metric {unknown.iloc[0]!r} (metrics: {', '.join(METRICS)})")
    try:
        table["value"] = table["value"].astype(np.float64)
        table["support"] = table["support"].astype(np.int64)
    except (TypeError, ValueError) as error:
        raise DataError(f"{source}: value and support must be numbers: {error}") from error
    if np.isinf(table["value"]).any() or (table["support"] < 0).any():
        bad = table[np.isinf(table["value"]) | (table["support"] < 0)].iloc[0]
        raise DataError(f"{source}: value {bad['value']} with support {bad['support']} in {bad[keys].tolist()}")
    twice = table[table.duplicated(keys)]
    if len(twice):
        raise DataError(f"{source}: two values for {twice[keys].iloc[0].tolist()}")
    return table


def scores_to_metrics(frame: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Return all defined scores by method as metrics, ``<split>/<metric>`` or ``<split>/<metric>/<class>``.

    Characters that MLflow does not take become ``_``.
    """
    table = check_scores(frame)
    metrics: dict[str, dict[str, float]] = {}
    for row in table[table["value"].notna()].itertuples(index=False, name=None):
        method, split, class_name, metric, value, _ = row
        levels = (split, metric) if class_name == ALL else (split, metric, class_name)
        name = _ILLEGAL.sub("_", "/".join(str(level).replace("/", "_") for level in levels))
        of_method = metrics.setdefault(str(method), {})
        if name in of_method:
            raise DataError(f"two scores of {method} are called {name!r}: rename the class {class_name!r}")
        of_method[name] = float(value)
    return metrics


def summary(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the scores over all classes, one row per method and split."""
    table = check_scores(frame)
    overall = table[table["class"] == ALL]
    wide = overall.pivot(index=["method", "split"], columns="metric", values="value")
    order = list(dict.fromkeys(zip(overall["method"], overall["split"], strict=True)))
    return wide.reindex(index=pd.MultiIndex.from_tuples(order, names=["method", "split"]),
                        columns=[metric for metric in METRICS if metric in wide.columns])  # fmt: skip
