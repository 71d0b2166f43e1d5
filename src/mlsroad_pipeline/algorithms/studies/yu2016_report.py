"""Figures and report of the study of Yu et al. 2016, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.rendering.cloud_figures import INK
from mlsroad_pipeline.algorithms.rendering.figures import SERIES, empty_figure, tidy_axes
from mlsroad_pipeline.algorithms.rendering.report import FactsSection, FiguresSection, Section, TableSection
from mlsroad_pipeline.algorithms.studies.yu2016_parameters import SEGMENTATIONS
from mlsroad_pipeline.algorithms.studies.yu2016_results import StudyPlan, StudyTables

_PANELS = {"pattern": "Feature regions (a)", "words_per_group": "Words per group (b)", "k": "Neighbours k (c)"}


def study_figures(tables: StudyTables) -> tuple[Figure, Figure]:
    """Draw the figures of the study.

    Parameters
    ----------
    tables : StudyTables
        The tables.

    Returns
    -------
    segmentation, figure_12 : Figure
        Coverage of the segmentations; precision-recall curves of the settings of the visual words.
    """
    return _coverage(tables.segmentation), _curves(tables.curves)


def _coverage(table: pd.DataFrame) -> Figure:
    surveys = list(dict.fromkeys(table["survey"]))
    figure = empty_figure(4.8 * len(surveys), 3.8)
    panels: Sequence[Axes] = np.atleast_1d(figure.subplots(1, len(surveys), sharey=True)).tolist()
    names = {"weighted_coverage": "weighted coverage", "coverage": "coverage", "touching": "coverage where they touch"}
    for axes, survey in zip(panels, surveys, strict=True):
        rows = table[table["survey"] == survey].set_index("method").reindex(SEGMENTATIONS)
        for k, method in enumerate(SEGMENTATIONS):
            places = np.arange(len(names)) + (k - 1.5) * 0.2
            values = rows.loc[method, list(names)].to_numpy(dtype=np.float64)
            spread = rows.loc[method, [f"{name}_spread" for name in names]].to_numpy(dtype=np.float64)
            axes.bar(places, np.nan_to_num(values), 0.18, color=SERIES[k], label=method.replace("_", " "))
            axes.errorbar(places, values, np.nan_to_num(spread), fmt="none", ecolor=INK, elinewidth=0.7)
        axes.set_xticks(range(len(names)), list(names.values()), fontsize=8)
        axes.set_title(survey, fontsize=9, color=INK)
        axes.set_ylim(0, 1.02)
        tidy_axes(axes)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left", ncols=4, frameon=False, fontsize=8)
    return figure


def _curves(curves: pd.DataFrame) -> Figure:
    figure = empty_figure(12.6, 3.8)
    panels: Sequence[Axes] = np.atleast_1d(figure.subplots(1, len(_PANELS), sharey=True)).tolist()
    for axes, (parameter, title) in zip(panels, _PANELS.items(), strict=True):
        mine = curves[curves["parameter"] == parameter] if len(curves) else curves
        settings = list(dict.fromkeys(mine["setting"])) if len(mine) else []
        for k, setting in enumerate(settings):
            one = mine[mine["setting"] == setting]
            axes.plot(one["recall"], one["precision"], color=SERIES[k % len(SERIES)], label=setting, linewidth=1.3)
            here = one[one["threshold"] >= 1.0].tail(1)
            axes.plot(here["recall"], here["precision"], "o", color=SERIES[k % len(SERIES)], markersize=4)
        if settings:
            axes.legend(frameon=False, fontsize=7, labelcolor=INK)
        axes.set_title(title, fontsize=9, color=INK)
        axes.set_xlabel("Recall", fontsize=9, color=INK)
        axes.set_xlim(0, 1.02)
        axes.set_ylim(0, 1.02)
        tidy_axes(axes)
    panels[0].set_ylabel("Precision (dots: chosen thresholds)", fontsize=9, color=INK)
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
        What was run, segmentation, Tables II to V, intervals, Figure 12.
    """
    facts = {
        name: f"{', '.join(f'{key} {value}' for key, value in given.survey.items())}; trained on {list(given.train)}, "
        f"tested on {list(given.test)}"
        for name, given in plan.scale.surveys.items()
    }
    spread = "Over the objects of all test streets; spread is the standard deviation from street to street."
    captions = ("Coverage of the segmentations", "Settings of the visual words: figure 12")
    return [
        FactsSection("What was run", facts),
        FiguresSection("Figures", dict(zip(captions, figures, strict=True))),
        TableSection("Segmentation", tables.segmentation, note="Mean over test streets; touching: instances that do."),
        TableSection("Table II: objects and detections", tables.table_2, note="Visual words."),
        TableSection("Table III: recall, precision, quality, F-score", tables.table_3, note=spread),
        TableSection("Table IV: time", tables.table_4, note="Processor seconds; points per second and thread."),
        TableSection("Table V: cars", tables.table_5, note=spread),
        TableSection(
            "Differences from the visual words",
            tables.differences,
            note="F-score of a method minus theirs, with 95 % intervals of the differences paired by street.",
        ),
        TableSection("Figure 12: settings", tables.figure_12),
    ]
