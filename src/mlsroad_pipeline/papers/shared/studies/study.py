"""Contents of a study: plan, stages of scene tasks, tables, figures and a page; and tables of several studies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from io import StringIO
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats

from mlsroad_pipeline.execution.task import SceneTask
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
