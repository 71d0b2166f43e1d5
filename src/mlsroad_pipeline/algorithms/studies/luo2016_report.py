"""Figures and report of the study of Luo et al. 2016, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.rendering.cloud_figures import INK
from mlsroad_pipeline.algorithms.rendering.figures import SERIES, empty_figure, tidy_axes
from mlsroad_pipeline.algorithms.rendering.report import FactsSection, FiguresSection, Section, TableSection
from mlsroad_pipeline.algorithms.studies.luo2016 import MEANS
from mlsroad_pipeline.algorithms.studies.luo2016_paper import CLASSES
from mlsroad_pipeline.algorithms.studies.luo2016_plan import StudyPlan
from mlsroad_pipeline.algorithms.studies.luo2016_results import StudyTables

__all__ = ["StudyTables", "study_figures", "study_sections", "wide_table"]


def wide_table(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Write Table III for people: a row per method, "mean ± spread (paper)" per class.

    Parameters
    ----------
    table : DataFrame
        What `table_three` gave.
    metric : str
        ``precision``, ``recall`` or ``f1``.

    Returns
    -------
    DataFrame
        Column `method`, then the classes and the means over classes; a dash for what a method cannot give.
    """
    chosen = table[table["metric"] == metric]
    cells = [_cell(*row) for row in chosen[["mean", "spread", "paper"]].itertuples(index=False, name=None)]
    wide = chosen.assign(cell=cells).pivot(index="method", columns="class", values="cell")
    order = list(dict.fromkeys(chosen["method"]))
    return wide.reindex(index=order, columns=[*CLASSES, *MEANS]).rename_axis(columns=None).reset_index()


def _cell(mean: float, spread: float, paper: float) -> str:
    ours = "–" if np.isnan(mean) else f"{mean:.3f}" if np.isnan(spread) else f"{mean:.3f} ± {spread:.3f}"
    return f"{ours} ({'–' if np.isnan(paper) else f'{paper:.3f}'})"


def study_figures(tables: StudyTables) -> tuple[Figure, Figure, Figure]:
    """Draw the figures of the study.

    Parameters
    ----------
    tables : StudyTables
        The tables.

    Returns
    -------
    methods, patch_size, search_radius : Figure
        F1 of the methods, ours and the paper's; Figures 7 and 8; Figures 9, 10 and 11.
    """
    size = _lines(tables.patch_size, "Patch size L, m", ("train_seconds",))
    radius = _lines(tables.search_radius, "Local search radius, m", ("train_seconds", "objective"))
    return _methods(tables.table_3), size, radius


def _methods(table: pd.DataFrame) -> Figure:
    figure = empty_figure(11, 4.2)
    axes = figure.add_subplot()
    chosen = table[table["metric"] == "f1"]
    methods, names = list(dict.fromkeys(chosen["method"])), [*CLASSES, *MEANS]
    width = 0.8 / len(methods)
    for k, method in enumerate(methods):
        rows = chosen[chosen["method"] == method].set_index("class").reindex(names)
        places = np.arange(len(names)) + (k - (len(methods) - 1) / 2) * width
        axes.bar(places, rows["mean"].fillna(0), width * 0.9, color=SERIES[k], label=method.replace("_", " "))
        axes.errorbar(places, rows["mean"], rows["spread"].fillna(0), fmt="none", ecolor=INK, elinewidth=0.7)
        axes.plot(places, rows["paper"], "D", color="white", markeredgecolor=INK, markersize=3.2)
    axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
    axes.set_ylim(0, 1.02)
    axes.set_ylabel("F1 (diamonds: luo2016)", fontsize=9, color=INK)
    tidy_axes(axes)
    figure.legend(loc="outside lower left", ncols=len(methods), frameon=False, fontsize=8, labelcolor=INK)
    return figure


_LABELS = {"train_seconds": "Training, processor s", "objective": "Objective (eq. 1)"}


def _lines(table: pd.DataFrame, label: str, columns: Sequence[str]) -> Figure:
    figure = empty_figure(4.4 * (1 + len(columns)), 3.8)
    panels: Sequence[Axes] = np.atleast_1d(figure.subplots(1, 1 + len(columns))).tolist()
    for k, name in enumerate((*CLASSES, "mean of seven")):
        width, colour = (2.2, INK) if name in MEANS else (1.2, SERIES[k])
        panels[0].plot(table["value"], table[name], marker="o", markersize=3, label=name, linewidth=width, color=colour)
    panels[0].set_ylim(0, 1.02)
    panels[0].set_ylabel("F1", fontsize=9, color=INK)
    panels[0].legend(frameon=False, fontsize=6.5, labelcolor=INK, ncols=2)
    for axes, column in zip(panels[1:], columns, strict=True):
        axes.plot(table["value"], table[column], marker="o", markersize=3, color=SERIES[0])
        axes.set_ylabel(_LABELS[column], fontsize=9, color=INK)
    for axes in panels:
        axes.set_xlabel(label, fontsize=9, color=INK)
        tidy_axes(axes)
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
        What was run, Table III, intervals, sensitivity, times, tuning.
    """
    scale = plan.scale
    facts = {
        "scale": plan.study.scale,
        "streets": ", ".join(f"{key} {value}" for key, value in scale.survey.items()),
        "test streets": ", ".join(f"{key} {value}" for key, value in scale.test_survey.items()) or "likewise",
        **{f"test streets {list(r['test'])}": f"trained on {list(r['train'])}" for r in scale.repetitions},
    }
    swapped = "Ours ± standard deviation over test streets (the paper's in brackets). "
    swapped += "The paper prints precision and recall with swapped names; here both have their usual meaning."
    captions = ("F1 of the methods", "Patch size: figures 7 and 8", "Local search radius: figures 9 to 11")
    return [
        FactsSection("What was run", facts),
        *(
            TableSection(f"Table III: {name}", wide_table(tables.table_3, metric), note=swapped)
            for name, metric in (("F1", "f1"), ("precision", "precision"), ("recall", "recall"))
        ),
        TableSection(
            "Differences from label transfer with refinement",
            tables.differences,
            note="Mean F1 of a method minus that of patch_graph_mrf, with 95 % intervals of the paired differences.",
        ),
        FiguresSection("Figures", dict(zip(captions, figures, strict=True))),
        TableSection("Patch size", tables.patch_size),
        TableSection("Local search radius", tables.search_radius),
        TableSection("Times", tables.times, note="Processor seconds here; hours of the paper's computer."),
        TableSection("Settings tried on training streets", tables.tuning),
    ]
