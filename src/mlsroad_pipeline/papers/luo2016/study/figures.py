"""Figures of the study of Luo et al. 2016, with the paper's values as diamonds."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.luo2016.study.plan import StudyPlan
from mlsroad_pipeline.papers.luo2016.study.runs import PRINTED, PRINTED_BASELINES, PRINTED_REFINED, REFINED
from mlsroad_pipeline.papers.luo2016.study.scores import CLASSES, MEANS
from mlsroad_pipeline.papers.shared.studies import study as studies
from mlsroad_pipeline.papers.shared.studies.streets import street_key
from mlsroad_pipeline.reporting.clouds.cloud_figures import INK, cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import oblique_view
from mlsroad_pipeline.reporting.figures import SERIES

CAPTIONS = {
    "methods": "F1 of the methods",
    "labelled": "A part of the first test street: figure 6",
    "patch_size": "Patch size: figures 7 and 8",
    "search_radius": "Local search radius: figures 9 to 11",
}
"""Name of each figure to its caption."""

PICTURED = ("max_margin_markov", PRINTED, PRINTED_REFINED, REFINED)
"""Methods of Figure 6; the first three are those of the paper."""

STRETCH = 25.0
"""Length of the part of the street in Figure 6, metres."""


def study_figures(
    tables: studies.Tables, plan: StudyPlan, streets: SceneCollection, runs: SceneCollection
) -> tuple[Figure, ...]:
    """Draw the figures in the order of `CAPTIONS`."""
    size = _lines(tables["patch_size"], "Patch size L, m", ("train_seconds",), "figure_7")
    radius = _lines(tables["search_radius"], "Local search radius, m", ("train_seconds", "objective"), "figure_9")
    return _methods(tables["table_3"]), _labelled(plan, streets, runs), size, radius


def _labelled(plan: StudyPlan, streets: SceneCollection, runs: SceneCollection) -> Figure:
    """Draw true classes and labels of a part of the first test street (Figure 6)."""
    street = streets[street_key(plan.scale.repetitions[0]["test"][0])].load()
    labels = {"true classes": plan.scheme.encode(street["label"], source=street.source)}
    for result in runs.part("pictured").load_all().values():
        labels |= {method: found for method, found in result.items() if method in PICTURED}
    station = street["station"]
    near = np.abs(station - np.median(station)) <= STRETCH / 2
    view = oblique_view(street.xyz[near], length=STRETCH)
    pictures = {
        name: labelling_pictures(street.xyz[near], view, classes=plan.scheme, predicted=labels[name][near])[
            "prediction"
        ]
        for name in ("true classes", *PICTURED)
    }
    return cloud_figure(pictures, view, classes=plan.scheme)


def _methods(table: pd.DataFrame) -> Figure:
    figure, (axes,) = studies.draw_panels(1, width=11, height=4.2)
    names = [*CLASSES, *MEANS]
    f1 = table[table["metric"] == "f1"]
    order = [method for method in dict.fromkeys(f1["method"]) if method not in PRINTED_BASELINES]
    wide = {column: f1.pivot(index="class", columns="method", values=column) for column in ("mean", "spread", "paper")}
    shown = {column: {slug: rows.reindex(names)[slug] for slug in order} for column, rows in wide.items()}
    studies.draw_bars(axes, names, shown["mean"], spread=shown["spread"], paper=shown["paper"])
    axes.tick_params("x", rotation=20)
    studies.name_axes(axes, y="F1 (diamonds: luo2016)", unit_range="y")
    studies.legend_below(figure, axes, len(order))
    return figure


_LABELS = {"train_seconds": "Training, CPU s", "objective": "Objective (eq. 1)"}


def _lines(table: pd.DataFrame, label: str, columns: Sequence[str], printed: str) -> Figure:
    """Draw F1 of the classes with the printed values of the paper as diamonds, and other columns."""
    figure, panels = studies.draw_panels(1 + len(columns), width=4.4)
    names = [*CLASSES, "mean of seven"]
    studies.draw_lines(panels[0], table["value"], {name: table[name] for name in names}, bold=("mean of seven",))
    paper = studies.paper_table("luo2016", printed)
    for value, name, f1 in paper.itertuples(index=False, name=None):
        colour = INK if name in MEANS else SERIES[names.index(name)]
        panels[0].plot(value, f1, "D", color="white", markeredgecolor=colour, markersize=4)
    known = [*table[names].min().dropna(), *paper["f1"]]
    lowest = np.floor(10 * min(known, default=0.0)) / 10
    studies.name_axes(panels[0], x=label, y="F1 (diamonds: luo2016)", unit_range="y", lowest=lowest)
    for axes, column in zip(panels[1:], columns, strict=True):
        studies.draw_lines(axes, table["value"], {column: table[column]})
        studies.name_axes(axes, x=label, y=_LABELS[column])
        if column == "train_seconds":
            axes.set_ylim(bottom=0)
    studies.legend_below(figure, panels[0], 4)
    return figure
