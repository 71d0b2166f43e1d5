"""The sections of the report of a comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from mlsroad_pipeline.reporting.html.report import Section
from mlsroad_pipeline.reporting.html.sections import FactsSection, FiguresSection, TableSection

TASK_TITLES = {
    "comparison": ("All labellers", "Means run over the classes that occur in the split."),
    "image_comparison": (
        "Labels through images, and their fusion",
        "test2 is the part of the test streets that the fusion was not learned on; splits that end in _visible have "
        "the points alone that cameras see.",
    ),
    "detection_comparison": ("All detectors", "Means over the classes that have objects in the split."),
    "recognition_comparison": (
        "All recognisers",
        "Counted in objects; means over the classes that occur.",
    ),
}
"""The table of a task to its heading and what stands above it."""

STAGE_TITLES = {
    "ground_scores": "Ground removal",
    "supervoxel_quality": "Supervoxels",
    "segmentation_scores": "Segmentation into objects",
    "survey_quality": "Quality of the survey",
}
"""The table of a stage to its heading."""

CAPTIONS = {
    "birds_eye": "Truth, prediction and errors from above",
    "perspective": "Truth, prediction and errors from the side",
    "confusion": "Confusion matrix",
    "bars": "Precision, recall, F1 and IoU per class",
    "precision_recall": "Precision against recall per class",
    "detections": "What was looked for, and what of it was found, missed or taken wrongly",
}
"""What the figures of a method show."""


def comparison_sections(
    facts: Mapping[str, Any],
    tables: Mapping[str, pd.DataFrame],
    scores: Mapping[str, pd.DataFrame],
    figures: Mapping[str, Mapping[str, Any]],
    *,
    tasks: Sequence[str],
) -> list[Section]:
    """Compose the report."""
    sections: list[Section] = [FactsSection("What was run", facts)]
    for task in tasks:
        title, note = TASK_TITLES[task]
        sections.append(TableSection(title, tables[task], note=note))
    for slug, mine in figures.items():
        sections.append(FiguresSection(slug, {CAPTIONS[name]: figure for name, figure in mine.items()}))
        sections.append(TableSection(f"{slug}: scores per class", per_class(scores[slug])))
    sections.extend(TableSection(title, tables[name]) for name, title in STAGE_TITLES.items())
    return sections


def per_class(scores: pd.DataFrame) -> pd.DataFrame:
    """Put the scores of each class in a row."""
    rows = scores[(scores["class"] != "all") & (scores["support"] > 0)]
    index = [*(["method"] if rows["method"].nunique() > 1 else []), "split", "class", "support"]
    wide = rows.set_index([*index, "metric"])["value"].unstack("metric", sort=False)
    return wide.reset_index().rename_axis(columns=None)
