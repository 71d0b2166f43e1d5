"""Figures of training: importances, out-of-bag error, objective."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures.style import GRID, SERIES, empty_figure, shown_names, tidy_axes


def importance_figure(
    importances: ArrayLike,
    *,
    names: Sequence[str],
    deviations: ArrayLike | None = None,
    largest: int = 25,
    title: str = "",
) -> Figure:
    """Draw the largest feature importances as horizontal bars."""
    values = np.asarray(importances, dtype=np.float64)
    if values.ndim != 1 or len(values) != len(names) or len(values) == 0:
        raise DataError(f"{len(names)} feature names for importances of shape {values.shape}")
    spread = None if deviations is None else np.asarray(deviations, dtype=np.float64)
    if spread is not None and spread.shape != values.shape:
        raise DataError(f"deviations of shape {spread.shape} for importances of shape {values.shape}")
    order = np.argsort(-values, kind="stable")[:largest]
    figure = empty_figure(6.5, 0.9 + 0.21 * len(order))
    axes = figure.add_subplot()
    whiskers = None if spread is None else spread[order]
    axes.barh(range(len(order)), values[order], 0.72, color=SERIES[0], xerr=whiskers,
              error_kw={"ecolor": "#8a93a3", "elinewidth": 0.8})  # fmt: skip
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
    if trees.ndim != 1 or trees.shape != error.shape or len(trees) == 0:
        raise DataError(f"errors of shape {error.shape} for numbers of trees of shape {trees.shape}")
    figure = empty_figure(6.5, 3.6)
    axes = figure.add_subplot()
    axes.plot(trees, 100 * error, color=SERIES[0], linewidth=1.6)
    if chosen is not None:
        axes.axvline(chosen, color=SERIES[5], linewidth=1, linestyle="--")
        axes.annotate(f"{chosen} trees", (chosen, 1), xycoords=("data", "axes fraction"), xytext=(-4, -4),
                      textcoords="offset points", ha="right", va="top", fontsize=8, color=SERIES[5])  # fmt: skip
    axes.set_xlabel("Number of trees", fontsize=9, color=INK)
    axes.set_ylabel("Out-of-bag error, %", fontsize=9, color=INK)
    axes.set_ylim(bottom=0)
    axes.grid(color=GRID, linewidth=0.7)
    tidy_axes(axes)
    axes.set_title(title or "Out-of-bag error", fontsize=10, color=INK, loc="left")
    return figure


def objective_figure(values: ArrayLike, *, title: str = "") -> Figure:
    """Draw an objective over the iterations of its minimisation."""
    objective = np.asarray(values, dtype=np.float64)
    if objective.ndim != 1 or len(objective) == 0:
        raise DataError(f"an objective has one value per iteration, got shape {objective.shape}")
    figure = empty_figure(6.5, 3.6)
    axes = figure.add_subplot()
    axes.plot(objective, color=SERIES[0], linewidth=1.6, marker="o", markersize=3)
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("Iteration", fontsize=9, color=INK)
    axes.set_ylabel("Objective", fontsize=9, color=INK)
    axes.grid(color=GRID, linewidth=0.7, which="both")
    tidy_axes(axes)
    axes.set_title(title or "Objective", fontsize=10, color=INK, loc="left")
    return figure
