"""Common style of figures: canvas, axes, colours of series, names of classes."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mlsroad_pipeline.reporting.clouds.cloud_figures import INK

_DPI = 150
GRID = "#e3e6eb"
"""Colour of the lines of a grid."""
SERIES = ("#1f4e96", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#7f7f7f", "#f0e442")
"""Colours of methods in bars, distinguishable under colour blindness (Okabe and Ito)."""


def empty_figure(width: float, height: float) -> Figure:
    """Return an empty figure on the Agg canvas, outside pyplot's global state."""
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def tidy_axes(axes: Axes) -> None:
    """Remove the top and right spines, and apply the style of ticks."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#9aa0aa")
    axes.tick_params(which="both", colors=INK, labelsize=8, length=3, color="#9aa0aa")
    axes.set_axisbelow(True)


def shown_names(names: Sequence[str]) -> list[str]:
    """Return names with spaces in place of underscores."""
    return [name.replace("_", " ") for name in names]
