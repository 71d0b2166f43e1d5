"""Sections of the report of a comparison."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from mlsroad_pipeline.reporting.html.report import Section, facts_section, figures_section, table_section

TASK_TITLES = {
    "comparison": ("Labelling methods", "Means over the classes that occur in the split."),
    "image_comparison": (
        "Image-based labelling and fusion",
        "test2 is the part of the test streets that the fusion was not fitted on; splits that end in _visible contain "
        "only points visible in images.",
    ),
    "detection_comparison": ("Detectors", "Means over the classes with objects in the split."),
    "recognition_comparison": (
        "Recognisers",
        "Counts are objects; means over the classes that occur.",
    ),
}
"""Table of a task to its heading and note."""

STAGE_TITLES = {
    "ground_scores": "Ground removal",
    "supervoxel_quality": "Supervoxels",
    "segmentation_scores": "Segmentation into objects",
    "survey_quality": "Survey quality",
}
"""Table of a stage to its heading."""

CAPTIONS = {
    "birds_eye": "Truth, prediction and errors from above",
    "perspective": "Truth, prediction and errors from the side",
    "confusion": "Confusion matrix",
    "bars": "Precision, recall, F1 and IoU per class",
    "precision_recall": "Precision against recall per class",
    "detections": "Reference objects, and detections: true positives, misses and false positives",
}
"""Captions of the figures of a method."""


def comparison_sections(
    facts: Mapping[str, Any],
    tables: Mapping[str, pd.DataFrame],
    scores: Mapping[str, pd.DataFrame],
    figures: Mapping[str, Mapping[str, Any]],
    *,
    tasks: Sequence[str],
) -> list[Section]:
    """Return the sections of the report."""
    sections = [facts_section("Run", facts)]
    for task in tasks:
        title, note = TASK_TITLES[task]
        sections.append(table_section(title, tables[task], note))
    for slug, drawn in figures.items():
        sections.append(figures_section(slug, {CAPTIONS[name]: figure for name, figure in drawn.items()}))
        sections.append(table_section(f"{slug}: scores per class", per_class(scores[slug])))
    sections.extend(table_section(title, tables[name]) for name, title in STAGE_TITLES.items())
    return sections


def per_class(scores: pd.DataFrame) -> pd.DataFrame:
    """Return the scores with one row per class."""
    rows = scores[(scores["class"] != "all") & (scores["support"] > 0)]
    index = [*(["method"] if rows["method"].nunique() > 1 else []), "split", "class", "support"]
    wide = rows.set_index([*index, "metric"])["value"].unstack("metric", sort=False)
    return wide.reset_index().rename_axis(columns=None)
