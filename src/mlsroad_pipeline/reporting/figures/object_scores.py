"""Figure of the precision-recall curves of an inventory."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.reporting.figures.style import GRID, SERIES, empty_figure, tidy_axes


def precision_recall_figure(curve: pd.DataFrame) -> Figure:
    """Draw precision over recall by kind, from all listed objects (dot) to those with the highest score."""
    figure = empty_figure(5.6, 4.2)
    axes = figure.add_subplot()
    for number, (kind, rows) in enumerate(curve.groupby("kind", sort=True)):
        colour = SERIES[number % len(SERIES)]
        axes.plot(rows["recall"], rows["precision"], color=colour, lw=1.6, label=str(kind))
        axes.plot(rows["recall"].iloc[0], rows["precision"].iloc[0], "o", color=colour, ms=5)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="Recall", ylabel="Precision")
    axes.grid(color=GRID)
    if not curve.empty:
        axes.legend(frameon=False, fontsize=8, loc="lower left")
    tidy_axes(axes)
    return figure
