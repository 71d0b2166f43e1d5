"""The sections of the report of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.rendering.report import Section
from mlsroad_pipeline.algorithms.rendering.report_sections import FactsSection, FiguresSection, TableSection

CAPTIONS = (
    "Truth, prediction and errors from above",
    "Truth, prediction and errors from the side",
    "Confusion matrix",
    "Precision, recall, F1 and IoU per class",
)
"""What the figures of a labeller show."""

DETECTOR_CAPTIONS = ("Precision against recall per class",)
"""What the figures of a detector show."""


def comparison_sections(
    facts: Mapping[str, Any],
    comparison: pd.DataFrame,
    detection: pd.DataFrame,
    tables: Mapping[str, pd.DataFrame],
    methods: Mapping[str, tuple[Any, ...]],
) -> list[Section]:
    """Compose the report.

    Parameters
    ----------
    facts : mapping
        What was run.
    comparison : DataFrame
        Overall figures of all labellers.
    detection : DataFrame
        Overall figures of all detectors.
    tables : mapping of str to DataFrame
        Heading to table.
    methods : mapping of str to tuple
        Slug to its scores and its figures, in the order of `CAPTIONS` or `DETECTOR_CAPTIONS`.

    Returns
    -------
    list of Section
        The parts of the page.
    """
    sections: list[Section] = [
        FactsSection("What was run", facts),
        TableSection("All labellers", comparison, note="Means run over the classes that occur in the split."),
        TableSection("All detectors", detection, note="Means over the classes that have objects in the split."),
    ]
    for slug, (scores, *figures) in methods.items():
        captions = CAPTIONS if len(figures) == len(CAPTIONS) else DETECTOR_CAPTIONS
        sections.append(FiguresSection(slug, dict(zip(captions, figures, strict=True))))
        sections.append(TableSection(f"{slug}: scores per class", per_class(scores)))
    sections.extend(TableSection(heading, table) for heading, table in tables.items())
    return sections


def per_class(scores: pd.DataFrame) -> pd.DataFrame:
    """Put the scores of each class in a row.

    Parameters
    ----------
    scores : DataFrame
        The table of scores of a method.

    Returns
    -------
    DataFrame
        One row per split and class, one column per metric.
    """
    rows = scores[scores["class"] != "all"]
    wide = rows.pivot_table(
        index=["split", "class", "support"], columns="metric", values="value", sort=False, dropna=False
    )
    return wide.reset_index().rename_axis(columns=None).loc[lambda t: t["support"] > 0]
