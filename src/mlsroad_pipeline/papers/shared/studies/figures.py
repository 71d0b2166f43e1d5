"""Drawing functions of all studies: panels, grouped bars, lines and curves."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures import SERIES, empty_figure, tidy_axes


def draw_panels(
    count: int, *, rows: int = 1, width: float = 4.2, height: float = 3.8, sharey: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, side by side."""
    figure = empty_figure(width * count, height * rows)
    panels: list[Axes] = figure.subplots(rows, count, sharey=sharey, squeeze=False).ravel().tolist()
    for axes in panels:
        tidy_axes(axes)
    return figure, panels


def name_axes(
    axes: Axes, *, x: str = "", y: str = "", title: str = "", unit_range: str = "", lowest: float = 0.0
) -> None:
    """Set axis labels, title and unit ranges of a panel."""
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)
    axes.set_title(title, fontsize=9, color=INK)
    if "x" in unit_range:
        axes.set_xlim(lowest, 1.02)
    if "y" in unit_range:
        axes.set_ylim(lowest, 1.02)


def draw_bars(
    axes: Axes,
    groups: Sequence[str],
    values: Mapping[str, ArrayLike],
    *,
    spread: Mapping[str, ArrayLike] | None = None,
    paper: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Draw one bar per series and group, with error bars of its spread and a diamond at the paper's value."""
    pitch = 0.8 / max(len(values), 1)
    for k, (name, heights) in enumerate(values.items()):
        places = np.arange(len(groups)) + (k - (len(values) - 1) / 2) * pitch
        axes.bar(
            places, np.nan_to_num(np.asarray(heights, np.float64)), pitch * 0.9, color=SERIES[k % len(SERIES)],
            label=name.replace("_", " "),
        )  # fmt: skip
        if spread is not None:
            half = np.nan_to_num(np.asarray(spread[name], np.float64))
            axes.errorbar(places, np.asarray(heights, np.float64), half, fmt="none", ecolor=INK, elinewidth=0.7)
        if paper is not None:
            marks = np.asarray(paper[name], np.float64)
            axes.plot(places, marks, "D", color="white", markeredgecolor=INK, markersize=3.2)
    axes.set_xticks(range(len(groups)), list(groups), fontsize=8)
    axes.set_xlim(-0.6, len(groups) - 0.4)


def _style(k: int) -> str:
    """Return the style of a line: dashed where colours repeat."""
    return "--" if k >= len(SERIES) else "-"


def draw_lines(axes: Axes, x: ArrayLike, series: Mapping[str, ArrayLike], *, bold: Sequence[str] = ()) -> None:
    """Draw one line with markers per series."""
    for k, (name, values) in enumerate(series.items()):
        width, colour = (2.2, INK) if name in bold else (1.2, SERIES[k % len(SERIES)])
        axes.plot(x, values, _style(k), marker="o", markersize=3, label=name, linewidth=width, color=colour)
    axes.set_xticks(np.asarray(x))  # only the values that were tried


def draw_curves(axes: Axes, curves: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> None:
    """Draw one curve per series, for instance precision against recall."""
    for k, (name, (x, y)) in enumerate(curves.items()):
        axes.plot(x, y, _style(k), color=SERIES[k % len(SERIES)], label=name, linewidth=1.3)
    if curves:
        axes.legend(frameon=False, fontsize=7, labelcolor=INK)


def legend_below(figure: Figure, axes: Axes, columns: int) -> None:
    """Draw the legend of a panel below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=columns, frameon=False, fontsize=8, labelcolor=INK)
