"""The scores of all methods, averaged over the test streets and compared in pairs."""

from __future__ import annotations

from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.reporting.html.report import build_report
from mlsroad_pipeline.studies.comparison.report import compare_task, comparison_sections, costs_table
from mlsroad_pipeline.studies.comparison.tables import TASKS, mean_scores, of_methods
from mlsroad_pipeline.surveys.parameters import SurveyParameters

PICTURED = (*methods_of("labelling"), "image_labels")
"""Methods whose labels are shown side by side."""
DETECTORS = methods_of("detection")
METHODS = (PICTURED, DETECTORS, methods_of("recognition"))
"""Slugs of the methods of each task, in the order of `TASKS`."""


def compare_over_streets(costs: pd.DataFrame, survey: SurveyParameters, *parts: Any) -> tuple[Any, ...]:
    """Compare the methods of every task."""
    slugs = [slug for methods in METHODS for slug in methods]
    scores = dict(zip(slugs, parts, strict=False))
    pictures = list(parts[len(slugs) :])
    joined = [of_methods([scores[slug] for slug in methods]) for methods in METHODS]
    compared = [compare_task(table, task) for table, task in zip(joined, TASKS, strict=True)]
    spent = costs_table(costs, slugs)
    headed = {
        "Labels from above: truth, prediction, errors": dict(zip(PICTURED, pictures, strict=False)),
        "Detectors: precision against recall": dict(zip(DETECTORS, pictures[len(PICTURED) :], strict=True)),
    }
    facts = {"survey": survey.root, "splits": dict(survey.splits), "classes": survey.evaluation_scheme or survey.scheme}
    page = build_report(comparison_sections(facts, compared, spent, headed), title="All methods")
    return (
        *(mean_scores(table) for table in joined),
        *(part for found in compared for part in (found.overview, found.classes, found.differences)),
        spent,
        page,
    )
