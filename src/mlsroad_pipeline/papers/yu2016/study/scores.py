"""Tables and figures of Yu et al. 2016, section V, from counted detections: Tables II to V, Figures 11 and 12."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.detection import DetectionCounts, count_detections, precision_recall_curve
from mlsroad_pipeline.papers.shared.studies import study as studies
from mlsroad_pipeline.papers.yu2016.study.parameters import SEGMENTATIONS
from mlsroad_pipeline.papers.yu2016.study.runs import StreetDetections
from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures import SERIES

FIGURES = ("recall", "precision", "quality", "f_score")

THREADS = 16
"""Threads of the paper's computer."""


def paper_speed() -> pd.DataFrame:
    """Return Table IV as points per second and thread."""
    table = studies.paper_table("yu2016", "table_4")
    return table[["survey", "step"]].assign(paper=table["points"] / table["seconds"] / THREADS)


def paper_cars() -> pd.DataFrame:
    """Return Table V as recall, precision and F-score."""
    table = studies.paper_table("yu2016", "table_5")
    tp, fp, objects = table["tp"], table["fp"], table["objects"]
    return table[["survey", "method"]].assign(
        paper_recall=tp / objects, paper_precision=tp / (tp + fp), paper_f_score=2 * tp / (tp + fp + objects)
    )


def counts_of(street: StreetDetections, classes: Sequence[int]) -> DetectionCounts:
    """Return the summed counts of some classes of a street."""
    tp = fp = fn = 0
    for k in classes:
        right = street["right"][street["label"] == k]
        counts = count_detections(right, max(int(street["n_objects"][k]), int(right.sum())))
        tp, fp, fn = tp + counts.tp, fp + counts.fp, fn + counts.fn
    return DetectionCounts(tp, fp, fn)


def joined(counts: Sequence[DetectionCounts]) -> DetectionCounts:
    """Return the sums of counts."""
    return DetectionCounts(*(sum(getattr(c, name) for c in counts) for name in ("tp", "fp", "fn")))


def table_two(streets: Mapping[str, Mapping[str, StreetDetections]], classes: Sequence[str]) -> pd.DataFrame:
    """Make Table II: objects, true and false detections of each class and survey."""
    rows = []
    for survey, each in streets.items():
        for name, chosen in [*((c, [k]) for k, c in enumerate(classes)), ("all", list(range(len(classes))))]:
            total = joined([counts_of(street, chosen) for street in each.values()])
            rows.append((survey, name, total.tp + total.fn, total.tp, total.fp))
    table = pd.DataFrame(rows, columns=["survey", "class", "objects", "found", "false"])
    return table.merge(studies.paper_table("yu2016", "table_2"), on=["survey", "class"], how="left")


def figures_by_survey(
    streets: Mapping[str, Mapping[str, Mapping[str, StreetDetections]]], classes: Sequence[int]
) -> pd.DataFrame:
    """Score methods per survey over the objects of all test streets, with the standard deviation between streets."""
    rows: list[tuple[Any, ...]] = []
    for method, surveys in streets.items():
        values: dict[str, list[float]] = {name: [] for name in FIGURES}
        for survey, each in surveys.items():
            counts = [counts_of(street, classes) for street in each.values()]
            total = joined(counts)
            for name in FIGURES:
                by_street = np.array([getattr(c, name) for c in counts], dtype=np.float64)
                known = by_street[np.isfinite(by_street)]
                spread = known.std(ddof=1) if len(known) > 1 else np.nan
                value = float(getattr(total, name))
                values[name].append(value)
                rows.append((survey, method, name, value, spread, total.tp, total.fp, total.fn))
        rows += [("average", method, name, float(np.mean(v)), np.nan, None, None, None) for name, v in values.items()]
    return pd.DataFrame(rows, columns=["survey", "method", "metric", "value", "spread", "tp", "fp", "fn"])


def paired_differences(
    streets: Mapping[str, Mapping[str, Mapping[str, StreetDetections]]],
    classes: Sequence[int],
    *,
    reference: str,
    confidence: float = 0.95,
) -> pd.DataFrame:
    """Compare the F-score of every method with that of a reference, street by street."""

    def f_scores(method: str) -> NDArray[np.float64]:
        each = [street for survey in streets[method].values() for street in survey.values()]
        return np.array([counts_of(street, classes).f_score for street in each], dtype=np.float64)

    first = f_scores(reference)
    rows = []
    for method in streets:
        if method == reference:
            continue
        rows.append((method, *studies.paired_interval(f_scores(method) - first, confidence)))
    return pd.DataFrame(rows, columns=["method", "difference", "low", "high", "streets"])


def pooled_curve(
    streets: Mapping[str, StreetDetections], thresholds: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return thresholds, precision and recall over all classes; scores are divided by the threshold of their class."""
    each = list(streets.values())
    label = np.concatenate([s["curve_label"] for s in each])
    right = np.concatenate([s["curve_right"] for s in each])
    score = np.concatenate([s["curve_score"] for s in each])
    n_objects = sum(np.maximum(s["n_objects"], np.bincount(s["curve_label"][s["curve_right"]].astype(np.int64),
                    minlength=len(thresholds))).sum() for s in each)  # fmt: skip
    if n_objects == 0:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    return precision_recall_curve(score / np.maximum(thresholds[label], 1e-12), right, int(n_objects))


def sensitivity_table(
    variants: Mapping[str, Mapping[str, StreetDetections]],
    thresholds: Mapping[str, NDArray[np.float64]],
    n_classes: int,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Make the table and the curves of Figure 12."""
    rows: list[tuple[Any, ...]] = []
    curves = []
    for name, streets in variants.items():
        parameter, _, value = name.partition("=")
        total = joined([counts_of(street, range(n_classes)) for street in streets.values()])
        level, precision, recall = pooled_curve(streets, thresholds[name])
        area = float(np.diff(recall, prepend=0.0) @ precision) if len(level) else np.nan
        rows.append((parameter, value, *(float(getattr(total, figure)) for figure in FIGURES), area))
        curves.append(
            pd.DataFrame(
                {"parameter": parameter, "setting": value, "threshold": level, "precision": precision, "recall": recall}
            )
        )
    table = pd.DataFrame(rows, columns=["parameter", "setting", *FIGURES, "average_precision"])
    return table, pd.concat(curves) if curves else pd.DataFrame()


CAPTIONS = {
    "segmentation": "Coverage of the segmentations",
    "figure_12": "Settings of the visual words: figure 12",
}
"""Name of each figure to its caption."""

_PANELS = {"pattern": "Feature regions (a)", "words_per_group": "Words per group (b)", "k": "Neighbours k (c)"}


def study_figures(tables: studies.Tables) -> tuple[Figure, ...]:
    """Draw the figures in the order of `CAPTIONS`."""
    return _coverage(tables["segmentation"]), _curves(tables["curves"])


def _coverage(table: pd.DataFrame) -> Figure:
    surveys = list(dict.fromkeys(table["survey"]))
    figure, panels = studies.draw_panels(len(surveys), width=4.8, sharey=True)
    names = {
        "weighted_coverage": "weighted coverage",
        "coverage": "coverage",
        "touching": "coverage of touching instances",
    }
    for axes, survey in zip(panels, surveys, strict=True):
        rows = table[table["survey"] == survey].set_index("method").reindex(SEGMENTATIONS)
        values = {method: rows.loc[method, list(names)] for method in SEGMENTATIONS}
        spread = {method: rows.loc[method, [f"{name}_spread" for name in names]] for method in SEGMENTATIONS}
        studies.draw_bars(axes, list(names.values()), values, spread=spread)
        studies.name_axes(axes, title=survey, unit_range="y")
    studies.legend_below(figure, panels[0], 3)
    return figure


def _curves(curves: pd.DataFrame) -> Figure:
    figure, panels = studies.draw_panels(len(_PANELS), sharey=True)
    for axes, (parameter, title) in zip(panels, _PANELS.items(), strict=True):
        mine = curves[curves["parameter"] == parameter] if len(curves) else curves
        settings = dict(iter(mine.groupby("setting", sort=False))) if len(mine) else {}
        studies.draw_curves(axes, {str(name): (one["recall"], one["precision"]) for name, one in settings.items()})
        for k, one in enumerate(settings.values()):
            here = one[one["threshold"] >= 1.0].tail(1)
            axes.plot(here["recall"], here["precision"], "o", color=SERIES[k % len(SERIES)], markersize=4)
        studies.name_axes(axes, x="Recall", title=title, unit_range="xy")
    panels[0].set_ylabel("Precision (dots: chosen thresholds)", fontsize=9, color=INK)
    return figure
