"""Maps of the point density and the maximum height of a survey."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.quality.inspection import SurveyMap
from mlsroad_pipeline.reporting.figures.style import empty_figure, tidy_axes

EMPTY = "#10141a"


def survey_map_figure(survey: SurveyMap, *, title: str = "") -> Figure:
    """Draw the point density and the maximum height of a survey."""
    rows, columns = survey.shape
    side_by_side = rows >= columns / 3
    figure = empty_figure(11.0, 5.2 if side_by_side else 6.5)
    axes = figure.subplots(*((1, 2) if side_by_side else (2, 1)))
    density = survey.density()
    top = np.where(survey.counts > 0, survey.top, np.nan)
    extent = (0.0, columns * survey.cell, 0.0, rows * survey.cell)
    full = np.isfinite(density)
    dense = LogNorm(*np.quantile(density[full], [0.01, 0.999]) * [1, 1.0001]) if full.any() else None
    heights = np.quantile(top[full], [0.01, 0.99]) if full.any() else (0.0, 1.0)
    drawn: tuple[tuple[NDArray, str, str, dict[str, Any]], ...] = (
        (density, "points per m²", "inferno", {"norm": dense}),
        (top, "maximum height, m", "viridis", {"vmin": heights[0], "vmax": heights[1]}),
    )
    for axis, (values, label, colours, scale) in zip(axes, drawn, strict=True):
        axis.set_facecolor(EMPTY)
        image = axis.imshow(
            values, origin="lower", extent=extent, cmap=mpl.colormaps[colours], interpolation="nearest", **scale
        )
        bar = figure.colorbar(image, ax=axis, shrink=0.75, pad=0.02)
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7)
        tidy_axes(axis)
        axis.set_xlabel("east, m", fontsize=8)
        axis.set_ylabel("north, m", fontsize=8)
        axis.tick_params(labelsize=7)
    if title:
        figure.suptitle(title, fontsize=10)
    return figure
