"""Page with the scores of an inventory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from mlsroad_pipeline.reporting.figures.object_scores import precision_recall_figure
from mlsroad_pipeline.reporting.html.gallery import GallerySection, Picture
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection, build_report

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
    sections: list[Section] = [
        FactsSection("Inventory and truth", facts),
        TableSection("Scores by kind", scores),
        FiguresSection("Precision and recall by score", {"Dots: all listed objects.": precision_recall_figure(curve)}),
        TableSection("Errors of position and of measures", measures),
        GallerySection("Worst objects", worst, NOTE),
    ]
    return build_report(sections, title="Scores of an inventory", subtitle=str(facts["inventory"]))
