"""Figures of the study of Luo et al. 2016, with the paper's values as diamonds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures.style import SERIES
from mlsroad_pipeline.studies.figures import draw_bars, draw_lines, draw_panels, legend_below, name_axes
from mlsroad_pipeline.studies.luo2016.paper import CLASSES, FIGURE_7, FIGURE_9
from mlsroad_pipeline.studies.luo2016.results import StudyTables
from mlsroad_pipeline.studies.luo2016.scores import MEANS

CAPTIONS = {
    "methods": "F1 of the methods",
    "patch_size": "Patch size: figures 7 and 8",
    "search_radius": "Local search radius: figures 9 to 11",
}
"""Name of each figure to its caption."""


def study_figures(tables: StudyTables) -> tuple[Figure, ...]:
    """Draw the figures in the order of `CAPTIONS`."""
    size = _lines(tables.patch_size, "Patch size L, m", ("train_seconds",), FIGURE_7)
    radius = _lines(tables.search_radius, "Local search radius, m", ("train_seconds", "objective"), FIGURE_9)
    return _methods(tables.table_3), size, radius


def _methods(table: pd.DataFrame) -> Figure:
    figure, (axes,) = draw_panels(1, width=11, height=4.2)
    names = [*CLASSES, *MEANS]
    f1 = table[table["metric"] == "f1"]
    order = list(dict.fromkeys(f1["method"]))
    wide = {column: f1.pivot(index="class", columns="method", values=column) for column in ("mean", "spread", "paper")}
    shown = {column: {slug: rows.reindex(names)[slug] for slug in order} for column, rows in wide.items()}
    draw_bars(axes, names, shown["mean"], spread=shown["spread"], paper=shown["paper"])
    axes.tick_params("x", rotation=20)
    name_axes(axes, y="F1 (diamonds: luo2016)", unit_range="y")
    legend_below(figure, axes, len(order))
    return figure


_LABELS = {"train_seconds": "Training, CPU s", "objective": "Objective (eq. 1)"}


def _lines(
    table: pd.DataFrame, label: str, columns: Sequence[str], paper: Mapping[float, Mapping[str, float]]
) -> Figure:
    """Draw F1 of the classes with the printed values of the paper as diamonds, and other columns."""
    figure, panels = draw_panels(1 + len(columns), width=4.4)
    names = [*CLASSES, "mean of seven"]
    draw_lines(panels[0], table["value"], {name: table[name] for name in names}, bold=("mean of seven",))
    for value, classes in paper.items():
        for name, f1 in classes.items():
            colour = INK if name in MEANS else SERIES[names.index(name)]
            panels[0].plot(value, f1, "D", color="white", markeredgecolor=colour, markersize=4)
    known = [*table[names].min().dropna(), *(f1 for classes in paper.values() for f1 in classes.values())]
    lowest = np.floor(10 * min(known, default=0.0)) / 10
    name_axes(panels[0], x=label, y="F1 (diamonds: luo2016)", unit_range="y", lowest=lowest)
    for axes, column in zip(panels[1:], columns, strict=True):
        draw_lines(axes, table["value"], {column: table[column]})
        name_axes(axes, x=label, y=_LABELS[column])
        if column == "train_seconds":
            axes.set_ylim(bottom=0)
    legend_below(figure, panels[0], 4)
    return figure
