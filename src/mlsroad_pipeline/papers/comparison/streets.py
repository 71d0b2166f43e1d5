"""Tables and report that compare all methods over several test streets."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.scores import ALL, COLUMNS, check_scores
from mlsroad_pipeline.papers.shared.studies.study import draw_panels, holm, name_axes, p_value, paired_interval
from mlsroad_pipeline.reporting.figures import SERIES
from mlsroad_pipeline.reporting.html.report import Section, facts_section, figures_section, table_section

MEAN = "mean_of_tests"
"""Split of means over the test streets in a table of scores."""


@dataclass(frozen=True)
class Task:
    """Metrics that the methods of one task are compared by."""

    name: str  # name of the task
    metrics: tuple[str, ...]  # metrics over all classes; methods are ordered by the first
    class_metric: str  # metric of each class


TASKS = (
    Task("labelling", ("mean_f1", "overall_accuracy", "mean_iou", "kappa"), "f1"),
    Task("detection", ("f_score", "quality", "precision", "recall"), "f_score"),
    Task("recognition", ("mean_f1", "weighted_f1", "overall_accuracy"), "f1"),
)
"""Tasks of the methods."""


def common_test_streets(scores: pd.DataFrame) -> list[str]:
    """Return the test streets that all methods of a table were scored on."""
    by_method = scores.groupby("method", sort=False)["split"].agg(set)
    common = set.intersection(*by_method) if len(by_method) else set()
    tests = [split for split in dict.fromkeys(scores["split"]) if split in common and split.startswith("test")]
    if not tests:
        splits_of = "; ".join(f"{method}: {', '.join(sorted(splits))}" for method, splits in by_method.items())
        raise DataError(f"no split whose name begins with 'test' was scored by all methods (splits of {splits_of})")
    return tests


def _overall(scores: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Return one metric over all classes, streets by methods."""
    rows = scores[(scores["class"] == ALL) & (scores["metric"] == metric)]
    wide = rows.pivot(index="split", columns="method", values="value")
    return wide.reindex(index=common_test_streets(scores), columns=list(dict.fromkeys(scores["method"])))


def overview(scores: pd.DataFrame, task: Task) -> pd.DataFrame:
    """Average the overall metrics of each method over the test streets."""
    table = check_scores(scores)
    columns: dict[str, pd.Series] = {}
    for metric in task.metrics:
        wide = _overall(table, metric)
        columns |= {metric: wide.mean(), f"{metric}_spread": wide.std(ddof=1)}
    means = pd.DataFrame(columns).rename_axis("method").reset_index()
    means.insert(1, "streets", len(common_test_streets(table)))
    return means.sort_values(task.metrics[0], ascending=False, kind="stable").reset_index(drop=True)


def class_table(scores: pd.DataFrame, task: Task) -> pd.DataFrame:
    """Average the metric of each class over the test streets that have the class."""
    table = check_scores(scores)
    chosen = table[table["split"].isin(common_test_streets(table)) & (table["metric"] == task.class_metric)]
    rows = chosen[(chosen["class"] != ALL) & (chosen["support"] > 0)]
    wide = rows.pivot_table(index="method", columns="class", values="value", sort=False, dropna=False)
    order = dict.fromkeys(overview(table, task)["method"])
    return wide.reindex(list(order)).rename_axis(columns=None).reset_index()


def paired_differences(scores: pd.DataFrame, task: Task) -> pd.DataFrame:
    """Compare the best method with every other one, paired by street."""
    table = check_scores(scores)
    ordered = overview(table, task)["method"].tolist()
    wide = _overall(table, task.metrics[0])
    rows = []
    for other in ordered[1:]:
        difference = (wide[ordered[0]] - wide[other]).to_numpy()
        mean, low, high, n = paired_interval(difference)
        rows.append((ordered[0], other, mean, low, high, p_value(difference), int((difference > 0).sum()), n))
    columns = ["best", "other", "difference", "low", "high", "p", "ahead", "streets"]
    differences = pd.DataFrame(rows, columns=columns)
    return differences.assign(p=holm(differences["p"].to_numpy(np.float64)))


def mean_scores(scores: pd.DataFrame) -> pd.DataFrame:
    """Average every metric of every method over the test streets."""
    table = check_scores(scores)
    rows = table[table["split"].isin(common_test_streets(table))]
    grouped = rows.groupby(["method", "class", "metric"], sort=False)
    means = grouped.agg(value=("value", "mean"), support=("support", "sum")).reset_index().assign(split=MEAN)
    return check_scores(means[list(COLUMNS)])


def of_methods(scores: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Join the tables of scores of several methods."""
    return check_scores(pd.concat(scores, ignore_index=True))


_NOTES = {
    "labelling": "Means over the classes that a method predicts and that occur. shape_based does not label the ground, "
    "so its means are over fewer classes. Points that no camera sees count as errors of image_labels.",
    "detection": "A detection is correct if it overlaps an object with at least the IoU in the parameters of "
    "`detection`. Means over the classes that have objects.",
    "recognition": "Objects are segments; their reference class is that of most of their points.",
}


@dataclass(frozen=True)
class TaskTables:
    """Tables and figure of one task."""

    task: Task  # task
    # overview, classes, differences: results of `overview`, `class_table` and `paired_differences`
    overview: pd.DataFrame
    classes: pd.DataFrame
    differences: pd.DataFrame
    figure: Figure  # first metric by test street


def compare_task(scores: pd.DataFrame, task: Task) -> TaskTables:
    """Compare the methods of one task."""
    table = overview(scores, task)
    figure = streets_figure(scores, task, table["method"].tolist())
    return TaskTables(task, table, class_table(scores, task), paired_differences(scores, task), figure)


def streets_figure(scores: pd.DataFrame, task: Task, methods: Sequence[str]) -> Figure:
    """Draw the first metric of a task: one marker per method and street, joined by street, and a bar at the mean."""
    metric = task.metrics[0]
    rows = scores[(scores["class"] == ALL) & (scores["metric"] == metric)]
    wide = rows.pivot(index="method", columns="split", values="value").reindex(list(methods))
    figure, (axes,) = draw_panels(1, width=max(6.0, 1.0 + 0.8 * len(methods)), height=3.8)
    places = np.arange(len(methods))
    for k, split in enumerate(common_test_streets(scores)):
        axes.plot(places, wide[split], "o-", color=SERIES[k % len(SERIES)], markersize=4, linewidth=0.5, label=split)
    axes.plot(places, wide[common_test_streets(scores)].mean(axis=1), "_", color="black", markersize=18, label="mean")
    axes.set_xticks(places, [name.replace("_", "\n") for name in methods], fontsize=7)
    name_axes(axes, y=metric.replace("_", " "), unit_range="y")
    axes.legend(frameon=False, fontsize=7, ncols=3, loc="lower left")
    return figure


def costs_table(costs: pd.DataFrame, methods: Sequence[str]) -> pd.DataFrame:
    """Return the summed time and the peak memory of each method and each shared stage."""
    maker = costs["makes"].fillna("").str.partition(".")[0]
    owner = maker.where(maker.isin(methods), costs["node"])
    grouped = costs.assign(method=owner).groupby("method", sort=False)
    table = grouped.agg(seconds=("seconds", "sum"), cpu_seconds=("cpu_seconds", "sum"), peak_gib=("peak_gib", "max"))
    return table.sort_values("seconds", ascending=False, kind="stable").reset_index()


def comparison_sections(
    facts: Mapping[str, Any],
    tasks: Sequence[TaskTables],
    costs: pd.DataFrame,
    pictures: Mapping[str, Mapping[str, NDArray[np.uint8]]],
) -> list[Section]:
    """Return the sections of the report."""
    sections = [facts_section("Runs", facts)]
    for one in tasks:
        name, metric = one.task.name, one.task.metrics[0].replace("_", " ")
        sections += [
            table_section(f"{name.capitalize()}: means over the test streets", one.overview, _NOTES[name]),
            figures_section(f"{name.capitalize()}: street by street", {f"{metric} of each test street": one.figure}),
            table_section(
                f"{name.capitalize()}: the best against the others", one.differences,
                f"{metric.capitalize()}, paired by street: 95 % t intervals, p values corrected after Holm.",
            ),
            table_section(f"{name.capitalize()}: {one.task.class_metric} per class", one.classes),
        ]  # fmt: skip
    note = "Wall and CPU seconds, and peak memory of all processes; stored results that were reused took no time."
    sections.append(table_section("Times and memory", costs, note))
    sections += [figures_section(heading, each) for heading, each in pictures.items()]
    return sections
