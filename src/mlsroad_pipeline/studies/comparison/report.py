"""The page that compares all methods over several test streets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.scores import ALL
from mlsroad_pipeline.reporting.figures.style import SERIES
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection
from mlsroad_pipeline.studies.comparison.tables import (
    Task,
    class_table,
    common_test_streets,
    overview,
    paired_differences,
)
from mlsroad_pipeline.studies.figures import draw_panels, name_axes

_NOTES = {
    "labelling": "Means run over the classes that a method can give and that occur: shape_based leaves the ground "
    "without labels, so its means are over other classes. Points that no camera sees are wrong for image_labels.",
    "detection": "A detection is right where it overlaps an object as the parameters of `detection` ask. Means run "
    "over the classes that have objects.",
    "recognition": "Objects as the segmentation cuts them, named by most of their points.",
}


@dataclass(frozen=True)
class TaskTables:
    """What is said of one task.

    Parameters
    ----------
    task : Task
        The task.
    overview, classes, differences : DataFrame
        What `comparison.overview`, `class_table` and `paired_differences` give.
    figure : Figure
        The first metric, street by street.
    """

    task: Task
    overview: pd.DataFrame
    classes: pd.DataFrame
    differences: pd.DataFrame
    figure: Figure


def compare_task(scores: pd.DataFrame, task: Task) -> TaskTables:
    """Compare the methods of one task."""
    found = overview(scores, task)
    figure = streets_figure(scores, task, found["method"].tolist())
    return TaskTables(task, found, class_table(scores, task), paired_differences(scores, task), figure)


def streets_figure(scores: pd.DataFrame, task: Task, methods: Sequence[str]) -> Figure:
    """Draw the first metric of a task: a dot per street, lines that join a street's dots, a bar at the mean."""
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
    """Add up what each method and each shared stage took."""
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
    """Compose the page."""
    sections: list[Section] = [FactsSection("What was run", facts)]
    for found in tasks:
        name, metric = found.task.name, found.task.metrics[0].replace("_", " ")
        sections += [
            TableSection(f"{name.capitalize()}: means over the test streets", found.overview, note=_NOTES[name]),
            FiguresSection(f"{name.capitalize()}: street by street", {f"{metric} of each test street": found.figure}),
            TableSection(
                f"{name.capitalize()}: the best against the others", found.differences,
                note=f"{metric.capitalize()}, paired by street: 95 % intervals after Student, p values after Holm.",
            ),
            TableSection(f"{name.capitalize()}: {found.task.class_metric} per class", found.classes),
        ]  # fmt: skip
    note = "Wall and processor seconds, and the largest memory of all processes; what was found stored took none."
    sections.append(TableSection("Times and memory", costs, note=note))
    sections += [FiguresSection(heading, each) for heading, each in pictures.items()]
    return sections
