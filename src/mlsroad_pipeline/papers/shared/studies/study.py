"""Contents of a study: plan, stages, tables, figures and a page; tables and figures of several studies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from io import StringIO
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures import SERIES, empty_figure, tidy_axes
from mlsroad_pipeline.reporting.html.report import build_report, facts_section, figures_section, table_section

Tables = Mapping[str, pd.DataFrame]
"""Tables of a study by name."""


class Stage(NamedTuple):
    """Node that creates scene tasks from the plan and earlier stages."""

    name: str  # name of the node
    tasks: Callable[..., Mapping[str, SceneTask]]  # takes the plan and the inputs, and returns a task per key
    inputs: Sequence[str]  # scene stores; a name with a dot is one of the catalog, others are the study's
    output: str  # scene store of the study


class Shown(NamedTuple):
    """Table on the page of a study; it is left out if it is empty."""

    title: str
    table: pd.DataFrame
    note: str = ""


@dataclass(frozen=True)
class Study:
    """Contents of a study."""

    name: str  # parameters, pipeline and entries of the catalog begin with ``<name>_study``
    title: str  # title of the page
    parameters: Sequence[str]  # groups of parameters that the plan is made from, besides the study's own
    plan: Callable[..., Any]  # takes the parameters of the study as `study`, and these groups by name
    stages: Sequence[Stage]
    results: Sequence[str]  # scene stores that the tables are made from
    tables: Sequence[str]  # names of the tables
    tabulate: Callable[..., Tables]  # takes the plan and the stores of `results`, and returns the tables
    captions: Mapping[str, str]  # name of each figure to its caption; its catalog entry ends in ``_figure``
    draw: Callable[..., Sequence[Figure]]  # takes the tables and the entries of `shown`, and returns the figures
    facts: Callable[[Any], Mapping[str, Any]]  # takes the plan, and returns facts of the runs
    page: Callable[[Any, Tables], Sequence[Shown]]  # takes the plan and the tables, and returns those of the page
    shown: Sequence[str] = ()  # the plan and scene stores, where figures need more than the tables

    def report(self, plan: Any, tables: Tables, figures: Sequence[Figure]) -> str:
        """Return the page: facts, figures and tables."""
        pictures = figures_section("Figures", dict(zip(self.captions.values(), figures, strict=True)))
        tabled = [table_section(*shown) for shown in self.page(plan, tables) if len(shown.table)]
        sections = [facts_section("Runs", self.facts(plan)), pictures, *tabled]
        return build_report(sections, title=self.title)


def paper_table(paper: str, name: str) -> pd.DataFrame:
    """Return a table of values that a paper prints, from the files of its study."""
    file = files("mlsroad_pipeline.papers").joinpath(paper, "study", "paper", f"{name}.csv")
    return pd.read_csv(StringIO(file.read_text(encoding="utf-8")), comment="#")


def paired_interval(differences: NDArray[np.floating], confidence: float = 0.95) -> tuple[float, float, float, int]:
    """Return mean, lower and upper bound (Student's t) and number of finite paired differences."""
    known = np.asarray(differences, dtype=np.float64)
    known = known[np.isfinite(known)]
    n = len(known)
    mean = float(known.mean()) if n else np.nan
    half = np.nan
    if n > 1:
        half = float(stats.t.ppf(0.5 + confidence / 2, n - 1) * known.std(ddof=1) / np.sqrt(n))
    return mean, mean - half, mean + half, n


def p_value(difference: NDArray[np.floating]) -> float:
    """Return the p-value of the paired t-test."""
    known = difference[np.isfinite(difference)]
    if len(known) < 2 or np.ptp(known) == 0:
        return float("nan")
    return float(stats.ttest_1samp(known, 0.0).pvalue)


def holm(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correct p values for multiple comparisons (Holm 1979); NaN values are not counted and stay NaN."""
    adjusted = np.full(len(p), np.nan)
    known = np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(p[known], kind="stable")]
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return adjusted


def mean_and_spread(rows: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Return mean and standard deviation of columns per group."""
    groups = rows.groupby(list(by), sort=False)[list(columns)]
    spread: Callable[[str], str] = "{}_spread".format
    return groups.mean().join(groups.std().rename(columns=spread)).reset_index()


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
