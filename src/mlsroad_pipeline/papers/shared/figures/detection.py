"""Precision-recall curves of detectors."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures.style import SERIES, empty_figure, tidy_axes

Curve = tuple[NDArray, NDArray, NDArray]


def precision_recall_figure(curves: Mapping[str, Curve], *, title: str) -> Figure:
    """Draw the precision-recall curve of each class."""
    figure = empty_figure(5.2, 4.2)
    axes = figure.add_subplot()
    for number, (name, (_, precision, recall)) in enumerate(curves.items()):
        colour = SERIES[number % len(SERIES)]
        axes.plot(recall, precision, drawstyle="steps-post", color=colour, linewidth=1.6, label=name)
        if len(recall):
            axes.plot(recall[-1:], precision[-1:], "o", color=colour, markersize=4)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="Recall", ylabel="Precision")
    axes.set_title(title, fontsize=10, color=INK, loc="left")
    axes.grid(color="#e3e6eb", linewidth=0.6)
    tidy_axes(axes)
    if curves:
        axes.legend(fontsize=8, frameon=False, loc="lower left")
    else:
        axes.text(0.5, 0.5, "no reference objects in this split", ha="center", transform=axes.transAxes, color=INK)
    return figure
