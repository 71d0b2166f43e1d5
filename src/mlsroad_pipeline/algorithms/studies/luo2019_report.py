"""Figures and report of the study of Luo et al. 2019, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.rendering.cloud_figures import INK
from mlsroad_pipeline.algorithms.rendering.figures import SERIES, empty_figure, tidy_axes
from mlsroad_pipeline.algorithms.rendering.report import FactsSection, FiguresSection, Section, TableSection
from mlsroad_pipeline.algorithms.studies.luo2019_parameters import (
    CLEAN,
    COMBINED,
    JOINTNET,
    KINDS,
    LABELS,
    METHODS,
    SUB_NETWORKS,
)
from mlsroad_pipeline.algorithms.studies.luo2019_plan import StudyPlan
from mlsroad_pipeline.algorithms.studies.luo2019_results import LEVELS, StudyTables

_TITLES = {
    "noise": "Gaussian noise, deviation", "keep": "Share of the points kept", "outliers": "Rate of outliers",
    "occlusion": "Rate of occlusion", LABELS: "Share of wrong classes",
}  # fmt: skip
CAPTIONS = {
    "figure_7": "Figure 7: image sizes",
    "figure_9": "Figure 9: F1 of the sub-networks on the paper's disturbed test sets",
    "figure_10": "Figure 10: confusion matrices there, share of each true class",
    "figure_11": "Figure 11: precision and recall",
    "figure_12": "Figure 12: disturbed test objects",
    "figure_13": "Figures 13 and 14c: disturbed training objects, tested on undisturbed ones",
    "figure_14": "Figures 14a and 14b: several disturbances of training objects at once",
}


def study_figures(tables: StudyTables) -> tuple[Figure, ...]:
    """Draw the figures of the study.

    Parameters
    ----------
    tables : StudyTables
        The tables.

    Returns
    -------
    tuple of Figure
        Figures 7, 9, 10, 11, 12, 13 and 14.
    """
    return (
        _figure_7(tables.curves[tables.curves["figure"] == 7]),
        _figure_9(tables.sub_networks),
        _figure_10(tables.confusions),
        _figure_11(tables.curves[tables.curves["figure"] == 11]),
        _figure_12(tables.robustness),
        _figure_13(tables.training),
        _figure_14(tables.curves[tables.curves["figure"] == 14]),
    )


def _grid(rows: int, columns: int, *, width: float = 3.7, height: float = 3.1) -> tuple[Figure, list[list[Axes]]]:
    figure = empty_figure(width * columns, height * rows + 0.5)
    found = figure.subplots(rows, columns, squeeze=False)
    return figure, [list(row) for row in found]


def _legend(figure: Figure, axes: Axes, columns: int) -> None:
    handles = axes.get_legend_handles_labels()
    if handles[0]:
        figure.legend(
            *handles, loc="outside lower left", ncols=columns, frameon=False, fontsize=8, labelcolor=INK
        )  # fmt: skip


def _colour(k: int) -> dict[str, Any]:
    return {"color": SERIES[k % len(SERIES)], "linestyle": "--" if k >= len(SERIES) else "-"}


def _curves(axes: Axes, table: pd.DataFrame, settings: Iterable[str], title: str) -> None:
    for k, setting in enumerate(settings):
        one = table[table["setting"] == setting]
        axes.plot(one["recall"], one["precision"], label=setting.replace("_", " "), linewidth=1.3, **_colour(k))
    axes.set_title(title, fontsize=9, color=INK)
    axes.set_xlabel("Recall", fontsize=8, color=INK)
    axes.set_ylabel("Precision", fontsize=8, color=INK)
    axes.set_xlim(0, 1.02)
    axes.set_ylim(0, 1.02)
    tidy_axes(axes)


def _figure_7(curves: pd.DataFrame) -> Figure:
    views = list(dict.fromkeys(setting.partition("=")[0] for setting in curves["setting"]))
    figure, panels = _grid(max(len(views), 1), len(LEVELS))
    for row, view in zip(panels, views, strict=False):
        settings = [s for s in dict.fromkeys(curves["setting"]) if s.startswith(f"{view}=")]
        for axes, level in zip(row, LEVELS, strict=True):
            title = f"{view.upper()}, test set {level[-1]}"
            _curves(axes, curves[curves["tested_on"] == level], settings, title)
            axes.legend(frameon=False, fontsize=7, labelcolor=INK)
    return figure


def _figure_9(table: pd.DataFrame) -> Figure:
    classes = list(dict.fromkeys(table["class"]))
    figure, panels = _grid(len(LEVELS), 1, width=10.0, height=2.6)
    methods = (*SUB_NETWORKS, JOINTNET)
    for (axes,), level in zip(panels, LEVELS, strict=True):
        for k, method in enumerate(methods):
            mine = table[(table["level"] == level) & (table["method"] == method)].set_index("class").reindex(classes)
            places = np.arange(len(classes)) + (k - 1.5) * 0.2
            axes.bar(places, mine["f1"].fillna(0), 0.18, label=method.replace("_", " "), color=SERIES[k])
        axes.set_xticks(range(len(classes)), classes)
        axes.set_ylim(0, 1.02)
        axes.set_ylabel(f"F1, test set {level[-1]}", fontsize=8, color=INK)
        tidy_axes(axes)
    _legend(figure, panels[0][0], len(methods))
    return figure


def _figure_10(table: pd.DataFrame) -> Figure:
    methods, classes = (*SUB_NETWORKS, JOINTNET), list(dict.fromkeys(table["class"]))
    figure, panels = _grid(len(LEVELS), len(methods), width=2.9, height=2.9)
    for row, level in zip(panels, LEVELS, strict=True):
        for axes, method in zip(row, methods, strict=True):
            mine = table[(table["level"] == level) & (table["method"] == method)]
            counts = mine.pivot_table(index="class", columns="recognised", values="objects", aggfunc="sum")
            shares = counts.reindex(index=classes, columns=classes).fillna(0).to_numpy(dtype=np.float64)
            shares = shares / np.maximum(shares.sum(axis=1, keepdims=True), 1)
            axes.imshow(shares, cmap="Blues", vmin=0, vmax=1)
            axes.set_xticks(range(len(classes)), classes, rotation=90, fontsize=6)
            axes.set_yticks(range(len(classes)), classes, fontsize=6)
            axes.set_title(f"{method.replace('_', ' ')}, test set {level[-1]}", fontsize=8, color=INK)
    return figure


def _figure_11(curves: pd.DataFrame) -> Figure:
    sets = list(dict.fromkeys(curves["set"]))
    figure, panels = _grid(1, len(sets), width=4.6, height=4.0)
    for axes, name in zip(panels[0], sets, strict=True):
        _curves(axes, curves[curves["set"] == name], METHODS, name)
    _legend(figure, panels[0][0], 3)
    return figure


def _lines(axes: Axes, table: pd.DataFrame, kind: str, k: int, label: str) -> None:
    """Draw accuracy by level, from the undisturbed objects on; down-sampling on a logarithmic axis."""
    mine = table[table["disturbance"].isin([CLEAN, kind])].sort_values("level")
    level = mine["level"].where(mine["disturbance"] != CLEAN, 1.0 if kind == "keep" else 0.0)
    order = np.argsort(level.to_numpy())
    axes.plot(
        level.to_numpy()[order], mine["accuracy"].to_numpy()[order], label=label, marker="o", markersize=3,
        linewidth=2.0 if label == JOINTNET else 1.1, **_colour(k),
    )  # fmt: skip
    if kind == "keep":
        axes.set_xscale("log", base=2)
        axes.xaxis.set_inverted(True)


def _finish(axes: Axes, kind: str, title: str) -> None:
    axes.set_xlabel(_TITLES[kind], fontsize=8, color=INK)
    axes.set_title(title, fontsize=9, color=INK)
    axes.set_ylabel("Accuracy", fontsize=8, color=INK)
    axes.set_ylim(0, 1.02)
    tidy_axes(axes)


def _figure_12(table: pd.DataFrame) -> Figure:
    sets = list(dict.fromkeys(table["set"]))
    figure, panels = _grid(len(sets), len(KINDS))
    for row, name in zip(panels, sets, strict=True):
        for axes, kind in zip(row, KINDS, strict=True):
            for k, method in enumerate(METHODS):
                _lines(axes, table[(table["set"] == name) & (table["method"] == method)], kind, k, method)
            _finish(axes, kind, name)
    _legend(figure, panels[0][0], 5)
    return figure


def _figure_13(table: pd.DataFrame) -> Figure:
    kinds = [kind for kind in (*KINDS, LABELS) if kind in set(table["disturbance"])]
    figure, panels = _grid(1, max(len(kinds), 1))
    for axes, kind in zip(panels[0], kinds, strict=False):
        for k, name in enumerate(dict.fromkeys(table["set"])):
            _lines(axes, table[table["set"] == name], kind, k, name)
        _finish(axes, kind, "")
    _legend(figure, panels[0][0], 4)
    return figure


def _figure_14(curves: pd.DataFrame) -> Figure:
    sets = list(dict.fromkeys(curves["set"]))
    settings = [s for s in dict.fromkeys(curves["setting"]) if s == CLEAN or s.startswith(COMBINED)]
    figure, panels = _grid(1, max(len(sets), 1), width=4.6, height=3.6)
    for axes, name in zip(panels[0], sets, strict=False):
        _curves(axes, curves[curves["set"] == name], settings, name)
    _legend(figure, panels[0][0], 4)
    return figure


def study_sections(plan: StudyPlan, tables: StudyTables, figures: Sequence[Figure]) -> list[Section]:
    """Put the study together for a report.

    Parameters
    ----------
    plan : StudyPlan
        The plan.
    tables : StudyTables
        The tables.
    figures : sequence of Figure
        What `study_figures` drew.

    Returns
    -------
    list of Section
        What was run, figures, tables.
    """
    scale = plan.scale
    facts = {
        "scale": plan.study.scale,
        "seeds of the methods": ", ".join(map(str, scale.seeds)),
        **{f"{COMBINED}={i}": f"noise, kept, outliers, occlusion {list(v)}" for i, v in enumerate(scale.combined, 1)},
        "Figures 7, 13 and 14": f"jointnet with {dict(scale.variants)}" if scale.variants else "jointnet as it is",
        "Sydney Urban Objects": ", ".join(plan.folds) or "not given",
    }
    means = "Means over classes on undisturbed test objects."
    paired = "Mean F1 of a method minus that of jointnet; 95 % intervals of 2,000 draws of test streets."
    times = (
        "Processor time on one thread, batches of 32 objects of 1,000 points; memory of a training step: weights, "
        "gradients, momenta and what is kept for the backward operation. The paper's are of a GPU; its recognition "
        "times are of test sets of some 4,500 and 1,900 objects."
    )
    three = [TableSection("Table 3: Sydney Urban Objects", tables.table_3)] if len(tables.table_3) else []
    tuned = [TableSection("Settings tried on validation objects", tables.tuning)] if len(tables.tuning) else []
    return [
        FactsSection("What was run", facts),
        FiguresSection("Figures", dict(zip(CAPTIONS.values(), figures, strict=True))),
        TableSection("Table 2: methods", tables.table_2, note=means),
        *three,
        TableSection("Differences from JointNet", tables.differences, note=paired),
        TableSection("Table 1: sub-networks", tables.table_1, note=times),
        TableSection("Table 4: efficiency", tables.table_4, note=times),
        TableSection("Figure 7: image sizes", tables.image_sizes),
        TableSection("Figure 12: disturbed test objects", tables.robustness),
        TableSection("Figures 13 and 14: disturbed training objects", tables.training),
        *tuned,
    ]
