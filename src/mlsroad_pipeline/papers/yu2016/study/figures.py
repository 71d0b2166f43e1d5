"""Figures of the study of Yu et al. 2016."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.papers.shared.studies.figures import draw_bars, draw_curves, draw_panels, legend_below, name_axes
from mlsroad_pipeline.papers.shared.studies.study import Tables
from mlsroad_pipeline.papers.yu2016.study.parameters import SEGMENTATIONS
from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures import SERIES

CAPTIONS = {
    "segmentation": "Coverage of the segmentations",
    "figure_12": "Settings of the visual words: figure 12",
}
"""Name of each figure to its caption."""

_PANELS = {"pattern": "Feature regions (a)", "words_per_group": "Words per group (b)", "k": "Neighbours k (c)"}


def study_figures(tables: Tables) -> tuple[Figure, ...]:
    """Draw the figures in the order of `CAPTIONS`."""
    return _coverage(tables["segmentation"]), _curves(tables["curves"])


def _coverage(table: pd.DataFrame) -> Figure:
    surveys = list(dict.fromkeys(table["survey"]))
    figure, panels = draw_panels(len(surveys), width=4.8, sharey=True)
    names = {
        "weighted_coverage": "weighted coverage",
        "coverage": "coverage",
        "touching": "coverage of touching instances",
    }
    for axes, survey in zip(panels, surveys, strict=True):
        rows = table[table["survey"] == survey].set_index("method").reindex(SEGMENTATIONS)
        values = {method: rows.loc[method, list(names)] for method in SEGMENTATIONS}
        spread = {method: rows.loc[method, [f"{name}_spread" for name in names]] for method in SEGMENTATIONS}
        draw_bars(axes, list(names.values()), values, spread=spread)
        name_axes(axes, title=survey, unit_range="y")
    legend_below(figure, panels[0], 3)
    return figure


def _curves(curves: pd.DataFrame) -> Figure:
    figure, panels = draw_panels(len(_PANELS), sharey=True)
    for axes, (parameter, title) in zip(panels, _PANELS.items(), strict=True):
        mine = curves[curves["parameter"] == parameter] if len(curves) else curves
        settings = dict(iter(mine.groupby("setting", sort=False))) if len(mine) else {}
        draw_curves(axes, {str(name): (one["recall"], one["precision"]) for name, one in settings.items()})
        for k, one in enumerate(settings.values()):
            here = one[one["threshold"] >= 1.0].tail(1)
            axes.plot(here["recall"], here["precision"], "o", color=SERIES[k % len(SERIES)], markersize=4)
        name_axes(axes, x="Recall", title=title, unit_range="xy")
    panels[0].set_ylabel("Precision (dots: chosen thresholds)", fontsize=9, color=INK)
    return figure
