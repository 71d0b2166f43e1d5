"""Figures of scores and of training, with their common style: confusion matrix, bars, importances, errors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.confusion import scores
from mlsroad_pipeline.algorithms.metrics.scores import ALL, CLASS_METRICS, check_scores
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


_SHARE_MAP = LinearSegmentedColormap.from_list("share", ["#ffffff", "#c7dcf0", "#5b9bd5", "#1f4e96", "#0d2a5c"])
TITLES = {"precision": "Precision", "recall": "Recall", "f1": "F1", "iou": "IoU"}


def _per_cent(share: float) -> str:
    """Format a share as per cent with one decimal; positive shares are never shown as 0."""
    return "<0.1" if share < 0.0005 else f"{100 * share:.1f}"


def short_count(count: int) -> str:
    """Format a count with at most four characters and a unit.

    Examples
    --------
    >>> [short_count(n) for n in (950, 12_345, 999_960, 4_100_000, 250_000_000)]
    ['950', '12.3k', '1M', '4.1M', '250M']
    """
    value = float(count)
    for unit in ("", "k", "M"):
        text = f"{value:.3g}"
        if float(text) < 1000:
            return text + unit
        value /= 1000
    return f"{value:.3g}G"


def confusion_figure(matrix: NDArray[np.integer], *, classes: Sequence[str], title: str = "") -> Figure:
    """Draw a confusion matrix with the shares of each true class and the counts."""
    support = scores(matrix).support
    counts = np.asarray(matrix)
    columns = shown_names(classes)
    if counts.shape[1] > len(support):
        if counts[:, -1].any():
            columns.append("unlabelled")
        else:
            counts = counts[:, :-1]
    shares = counts / np.where(support > 0, support, 1)[:, None]
    cell = 0.66 if len(classes) <= 12 else 0.56
    figure = empty_figure(2.6 + cell * counts.shape[1], 1.7 + cell * counts.shape[0])
    axes = figure.add_subplot()
    axes.imshow(shares, cmap=_SHARE_MAP, vmin=0, vmax=1, aspect="equal")
    for row, column in zip(*np.nonzero(counts), strict=True):
        ink = "white" if shares[row, column] > 0.5 else INK
        place: dict[str, Any] = {"ha": "center", "color": ink}
        axes.text(column, row - 0.08, _per_cent(shares[row, column]), va="center", fontsize=8.5, **place)
        axes.text(column, row + 0.27, short_count(int(counts[row, column])), va="center", fontsize=6, **place)
    axes.set_xticks(range(len(columns)), columns, rotation=40, ha="right", rotation_mode="anchor")
    axes.set_yticks(
        range(len(classes)),
        [f"{n} ({short_count(int(s))})" for n, s in zip(shown_names(classes), support, strict=True)],
    )
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(classes) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color=GRID, linewidth=0.8)
    axes.tick_params(which="both", length=0, labelsize=8.5, colors=INK)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("Predicted class", color=INK, fontsize=9)
    axes.set_ylabel("True class (points)", color=INK, fontsize=9)
    axes.set_title(title or "Confusion matrix, % of each true class", fontsize=10, color=INK, loc="left")
    return figure


def class_bars_figure(frame: pd.DataFrame, *, split: str, title: str = "") -> Figure:
    """Draw precision, recall, F1 and IoU per class, one bar per method."""
    table = check_scores(frame)
    table = table[(table["split"] == split) & (table["class"] != ALL) & table["metric"].isin(CLASS_METRICS)]
    if table.empty:
        raise DataError(f"no scores per class of split {split!r} (splits: {sorted(set(frame['split']))})")
    methods, classes = list(dict.fromkeys(table["method"])), list(dict.fromkeys(table["class"]))
    figure = empty_figure(max(6.5, 1.6 + len(classes) * (0.36 + 0.12 * len(methods))), 7.2)
    panels = np.atleast_1d(figure.subplots(len(CLASS_METRICS), 1, sharex=True))
    for axes, metric in zip(panels, CLASS_METRICS, strict=True):
        wide = table[table["metric"] == metric].pivot(index="class", columns="method", values="value")
        _bars(axes, wide.reindex(index=classes, columns=methods).to_numpy(dtype=np.float64))
        axes.set_ylabel(TITLES[metric], fontsize=9, color=INK)
    support = table.drop_duplicates("class").set_index("class")["support"]
    names = [f"{n}\n{short_count(int(support[c]))}" for n, c in zip(shown_names(classes), classes, strict=True)]
    rotation = {"rotation": 35, "ha": "right", "rotation_mode": "anchor"} if len(classes) > 7 else {}
    panels[-1].set_xticks(range(len(classes)), names, **rotation)
    figure.suptitle(title or f"Scores per class on {split}", fontsize=10.5, color=INK, x=0.01, ha="left")
    if len(methods) > 1:
        labels = [method.replace("_", " ") for method in methods]
        figure.legend(
            panels[0].containers[: len(methods)], labels, loc="outside lower left", ncols=min(4, len(methods)),
            frameon=False, fontsize=8.5, labelcolor=INK,
        )  # fmt: skip
    return figure


def _bars(axes: Axes, values: NDArray[np.float64]) -> None:
    """Draw groups of bars, with values above them for a single method."""
    n_classes, n_methods = values.shape
    width = 0.8 / n_methods
    for k in range(n_methods):
        places = np.arange(n_classes) + (k - (n_methods - 1) / 2) * width
        heights = np.nan_to_num(values[:, k])
        axes.bar(places, heights, width * 0.92, color=SERIES[k % len(SERIES)], hatch="//" if k >= len(SERIES) else None)
        for place, value in zip(places, values[:, k], strict=True):
            if np.isnan(value):
                axes.text(place, 0.02, "–", ha="center", fontsize=8, color=INK)
            elif n_methods == 1:
                axes.text(place, value + 0.02, f"{value:.2f}", ha="center", fontsize=7, color=INK)
    axes.set_xlim(-0.6, n_classes - 0.4)
    axes.set_ylim(0, 1.14 if n_methods == 1 else 1.02)
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "", "0.5", "", "1"])
    axes.grid(axis="y", color=GRID, linewidth=0.7)
    tidy_axes(axes)


def importance_figure(
    importances: ArrayLike,
    *,
    names: Sequence[str],
    largest: int = 25,
    title: str = "",
) -> Figure:
    """Draw the largest feature importances as horizontal bars."""
    values = np.asarray(importances, dtype=np.float64)
    order = np.argsort(-values, kind="stable")[:largest]
    figure = empty_figure(6.5, 0.9 + 0.21 * len(order))
    axes = figure.add_subplot()
    axes.barh(range(len(order)), values[order], 0.72, color=SERIES[0])
    axes.set_yticks(range(len(order)), shown_names([names[k] for k in order]))
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.set_xlim(left=0)
    axes.set_xlabel("Importance (mean decrease of impurity)", fontsize=9, color=INK)
    axes.grid(axis="x", color=GRID, linewidth=0.7)
    tidy_axes(axes)
    shown = f"the {len(order)} largest of {len(values)}" if len(order) < len(values) else f"all {len(values)}"
    axes.set_title(title or f"Feature importances, {shown}", fontsize=10, color=INK, loc="left")
    return figure


def oob_figure(n_trees: ArrayLike, errors: ArrayLike, *, chosen: int | None = None, title: str = "") -> Figure:
    """Draw the out-of-bag error over the number of trees."""
    trees, error = np.asarray(n_trees), np.asarray(errors, dtype=np.float64)
    figure, axes = _curve(title or "Out-of-bag error", "Number of trees", "Out-of-bag error, %")
    axes.plot(trees, 100 * error, color=SERIES[0], linewidth=1.6)
    if chosen is not None:
        axes.axvline(chosen, color=SERIES[5], linewidth=1, linestyle="--")
        axes.annotate(f"{chosen} trees", (chosen, 1), xycoords=("data", "axes fraction"), xytext=(-4, -4),
                      textcoords="offset points", ha="right", va="top", fontsize=8, color=SERIES[5])  # fmt: skip
    axes.set_ylim(bottom=0)
    axes.grid(color=GRID, linewidth=0.7)
    return figure


def _curve(title: str, along: str, up: str) -> tuple[Figure, Axes]:
    """Return an empty figure for a curve, and its axes."""
    figure = empty_figure(6.5, 3.6)
    axes = figure.add_subplot()
    axes.set_xlabel(along, fontsize=9, color=INK)
    axes.set_ylabel(up, fontsize=9, color=INK)
    tidy_axes(axes)
    axes.set_title(title, fontsize=10, color=INK, loc="left")
    return figure, axes


def objective_figure(values: ArrayLike, *, title: str = "") -> Figure:
    """Draw an objective over the iterations of its minimisation."""
    figure, axes = _curve(title or "Objective", "Iteration", "Objective")
    axes.plot(values, color=SERIES[0], linewidth=1.6, marker="o", markersize=3)
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(color=GRID, linewidth=0.7, which="both")
    return figure
