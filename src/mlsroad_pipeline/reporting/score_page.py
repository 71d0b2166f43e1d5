"""Page with the scores of an inventory, with its precision-recall curves."""

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.reporting.figures import GRID, SERIES, empty_figure, tidy_axes
from mlsroad_pipeline.reporting.html.report import (
    Picture,
    build_report,
    facts_section,
    figures_section,
    gallery_section,
    table_section,
)


def precision_recall_figure(curve: pd.DataFrame) -> Figure:
    """Draw precision over recall by kind, from all listed objects (dot) to those with the highest score."""
    figure = empty_figure(5.6, 4.2)
    axes = figure.add_subplot()
    for number, (kind, rows) in enumerate(curve.groupby("kind", sort=True)):
        colour = SERIES[number % len(SERIES)]
        axes.plot(rows["recall"], rows["precision"], color=colour, lw=1.6, label=str(kind))
        axes.plot(rows["recall"].iloc[0], rows["precision"].iloc[0], "o", color=colour, ms=5)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="Recall", ylabel="Precision")
    axes.grid(color=GRID)
    if not curve.empty:
        axes.legend(frameon=False, fontsize=8, loc="lower left")
    tidy_axes(axes)
    return figure


NOTE = (
    "From above, north up, and from the south. A red cross marks the listed object, a blue circle the true one. "
    "Colours are the classes of the labelled cloud."
)


def score_page(
    facts: Mapping[str, object],
    scores: pd.DataFrame,
    curve: pd.DataFrame,
    measures: pd.DataFrame,
    worst: Mapping[str, Sequence[Picture]],
) -> str:
    """Return the page: scores by kind, curves, errors of measures, pictures of the worst objects."""
    sections = [
        facts_section("Inventory and truth", facts),
        table_section("Scores by kind", scores),
        figures_section("Precision and recall by score", {"Dots: all listed objects.": precision_recall_figure(curve)}),
        table_section("Errors of position and of measures", measures),
        gallery_section("Worst objects", worst, NOTE),
    ]
    return build_report(sections, title="Scores of an inventory", subtitle=str(facts["inventory"]))
