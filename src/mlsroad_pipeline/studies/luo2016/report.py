"""Figures and report of the study of Luo et al. 2016, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.reporting.clouds.cloud_figures import INK
from mlsroad_pipeline.reporting.figures.style import SERIES
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection
from mlsroad_pipeline.studies.figures import draw_bars, draw_lines, draw_panels, legend_below, name_axes
from mlsroad_pipeline.studies.luo2016.paper import CLASSES, FIGURE_7, FIGURE_9
from mlsroad_pipeline.studies.luo2016.plan import StudyPlan
from mlsroad_pipeline.studies.luo2016.results import StudyTables
from mlsroad_pipeline.studies.luo2016.scores import MEANS

PAPER_ON_PATCH_SIZE = (
    "The paper (diamonds at 0.2 m: its Table III; its curves are not printed as numbers): road, grass, palm tree and "
    "cycas change slightly, vehicle falls from 0.85 at 0.20 m to 0.69 at 0.35 m, light pole falls sharply from 0.30 to "
    "0.35 m, and training gets faster as patches grow. It takes 0.2 m."
)
PAPER_ON_SEARCH_RADIUS = (
    "The paper (diamonds at 1.0 m: its Table III): F1 hardly changes from 0.3 to 1.5 m, the objective falls "
    "as the radius grows, and training takes longer. It takes 1.0 m."
)

__all__ = ["StudyTables", "study_figures", "study_sections", "wide_table"]


def wide_table(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Write Table III for people: a row per method, "mean (paper)" per class, and "± spread" of means over classes."""
    chosen = table[table["metric"] == metric]
    spread = chosen["spread"].where(chosen["class"].isin(MEANS))  # ten columns with spreads are wider than a page
    rows = zip(chosen["mean"], spread, chosen["paper"], strict=True)
    cells = [_cell(*row) for row in rows]
    wide = chosen.assign(cell=cells).pivot(index="method", columns="class", values="cell")
    order = list(dict.fromkeys(chosen["method"]))
    return wide.reindex(index=order, columns=[*CLASSES, *MEANS]).rename_axis(columns=None).reset_index()


def _cell(mean: float, spread: float, paper: float) -> str:
    ours = "–" if np.isnan(mean) else f"{mean:.3f}" if np.isnan(spread) else f"{mean:.3f} ± {spread:.3f}"
    return f"{ours} ({'–' if np.isnan(paper) else f'{paper:.3f}'})"


def study_figures(tables: StudyTables) -> tuple[Figure, Figure, Figure]:
    """Draw the figures of the study."""
    size = _lines(tables.patch_size, "Patch size L, m", ("train_seconds",), FIGURE_7)
    radius = _lines(tables.search_radius, "Local search radius, m", ("train_seconds", "objective"), FIGURE_9)
    return _methods(tables.table_3), size, radius


def _methods(table: pd.DataFrame) -> Figure:
    figure, (axes,) = draw_panels(1, width=11, height=4.2)
    names = [*CLASSES, *MEANS]
    f1 = table[table["metric"] == "f1"]
    order = list(dict.fromkeys(f1["method"]))
    wide = {column: f1.pivot(index="class", columns="method", values=column) for column in ("mean", "spread", "paper")}
    shown = {column: {slug: rows.reindex(names)[slug] for slug in order} for column, rows in wide.items()}
    draw_bars(axes, names, shown["mean"], spread=shown["spread"], paper=shown["paper"])
    axes.tick_params("x", rotation=20)
    name_axes(axes, y="F1 (diamonds: luo2016)", unit_range="y")
    legend_below(figure, axes, len(order))
    return figure


_LABELS = {"train_seconds": "Training, processor s", "objective": "Objective (eq. 1)"}


def _lines(
    table: pd.DataFrame, label: str, columns: Sequence[str], paper: Mapping[float, Mapping[str, float]]
) -> Figure:
    """Draw F1 of the classes, with the paper's as diamonds where its text tells them, and other columns."""
    figure, panels = draw_panels(1 + len(columns), width=4.4)
    names = [*CLASSES, "mean of seven"]
    draw_lines(panels[0], table["value"], {name: table[name] for name in names}, bold=("mean of seven",))
    for value, classes in paper.items():
        for name, f1 in classes.items():
            colour = INK if name in MEANS else SERIES[names.index(name)]
            panels[0].plot(value, f1, "D", color="white", markeredgecolor=colour, markersize=4)
    known = [*table[names].min().dropna(), *(f1 for classes in paper.values() for f1 in classes.values())]
    lowest = np.floor(10 * min(known, default=0.0)) / 10
    name_axes(panels[0], x=label, y="F1 (diamonds: luo2016)", unit_range="y", lowest=lowest)
    for axes, column in zip(panels[1:], columns, strict=True):
        draw_lines(axes, table["value"], {column: table[column]})
        name_axes(axes, x=label, y=_LABELS[column])
        if column == "train_seconds":
            axes.set_ylim(bottom=0)
    legend_below(figure, panels[0], 4)
    return figure


def _listed(values: Mapping[str, Any]) -> str:
    """Write names and values in a row, nested ones in brackets."""
    pairs = ((key, f"({_listed(v)})" if isinstance(v, Mapping) else v) for key, v in values.items())
    return ", ".join(f"{key} {value}" for key, value in pairs)


def study_sections(plan: StudyPlan, tables: StudyTables, figures: Sequence[Figure]) -> list[Section]:
    """Put the study together for a report."""
    scale = plan.scale
    facts = {
        "scale": plan.study.scale,
        "streets": _listed(scale.survey),
        "test streets": _listed(scale.test_survey) or "likewise",
        **{f"test streets {list(r['test'])}": f"trained on {list(r['train'])}" for r in scale.repetitions},
    }
    swapped = "Ours ± standard deviation over test streets (the paper's in brackets). "
    swapped += "The paper prints precision and recall with swapped names; here both have their usual meaning."
    captions = ("F1 of the methods", "Patch size: figures 7 and 8", "Local search radius: figures 9 to 11")
    return [
        FactsSection("What was run", facts),
        *(
            TableSection(f"Table III: {name}", wide_table(tables.table_3, metric), note=swapped)
            for name, metric in (("F1", "f1"), ("precision", "precision"), ("recall", "recall"))
        ),
        TableSection(
            "Differences from label transfer with refinement",
            tables.differences.round(3),
            note="Mean F1 of a method minus that of patch_graph_mrf, with 95 % intervals of the paired differences.",
        ),
        FiguresSection("Figures", dict(zip(captions, figures, strict=True))),
        TableSection("Patch size", tables.patch_size.round(3), note=PAPER_ON_PATCH_SIZE),
        TableSection("Local search radius", tables.search_radius.round(3), note=PAPER_ON_SEARCH_RADIUS),
        TableSection("Times", tables.times, note="Processor seconds here; hours of the paper's computer."),
        TableSection("Settings tried on training streets", tables.tuning),
    ]
