"""Report that compares all methods over several test streets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.scores import ALL
from mlsroad_pipeline.papers.comparison.streets.tables import (
    Task,
    class_table,
    common_test_streets,
    overview,
    paired_differences,
)
from mlsroad_pipeline.papers.shared.studies.figures import draw_panels, name_axes
from mlsroad_pipeline.reporting.figures.style import SERIES
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection

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
    sections: list[Section] = [FactsSection("Runs", facts)]
    for one in tasks:
        name, metric = one.task.name, one.task.metrics[0].replace("_", " ")
        sections += [
            TableSection(f"{name.capitalize()}: means over the test streets", one.overview, note=_NOTES[name]),
            FiguresSection(f"{name.capitalize()}: street by street", {f"{metric} of each test street": one.figure}),
            TableSection(
                f"{name.capitalize()}: the best against the others", one.differences,
                note=f"{metric.capitalize()}, paired by street: 95 % t intervals, p values corrected after Holm.",
            ),
            TableSection(f"{name.capitalize()}: {one.task.class_metric} per class", one.classes),
        ]  # fmt: skip
    note = "Wall and CPU seconds, and peak memory of all processes; stored results that were reused took no time."
    sections.append(TableSection("Times and memory", costs, note=note))
    sections += [FiguresSection(heading, each) for heading, each in pictures.items()]
    return sections
