"""Nodes of the comparison over several test streets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.papers.comparison.streets.report import compare_task, comparison_sections, costs_table
from mlsroad_pipeline.papers.comparison.streets.tables import TASKS, mean_scores, of_methods
from mlsroad_pipeline.reporting.html.report import build_report
from mlsroad_pipeline.surveys.parameters import SurveyParameters

PICTURED = (*methods_of("labelling"), "image_labels")
"""Methods with a picture of their labels."""
DETECTORS = methods_of("detection")
METHODS = (PICTURED, DETECTORS, methods_of("recognition"))
"""Slugs of the methods of each task, in the order of `TASKS`."""


def compare_over_streets(costs: pd.DataFrame, survey: SurveyParameters, *parts: Any) -> tuple[Any, ...]:
    """Compare the methods of every task."""
    slugs = [slug for methods in METHODS for slug in methods]
    scores, pictures = dict(zip(slugs, parts, strict=False)), parts[len(slugs) :]
    joined = [of_methods([scores[slug] for slug in methods]) for methods in METHODS]
    compared = [compare_task(table, task) for table, task in zip(joined, TASKS, strict=True)]
    spent = costs_table(costs, slugs)
    facts = {"survey": survey.root, "splits": dict(survey.splits), "classes": survey.evaluation_scheme or survey.scheme}
    sections = comparison_sections(facts, compared, spent, _headed(pictures))
    means = [mean_scores(table) for table in joined]
    tables = [table for task in compared for table in (task.overview, task.classes, task.differences)]
    return *means, *tables, spent, build_report(sections, title="All methods")


def _headed(pictures: Sequence[NDArray[np.uint8]]) -> dict[str, dict[str, NDArray[np.uint8]]]:
    """Return the pictures of the methods by heading."""
    return {
        "Labels from above: truth, prediction, errors": dict(zip(PICTURED, pictures, strict=False)),
        "Detectors: precision against recall": dict(zip(DETECTORS, pictures[len(PICTURED) :], strict=True)),
    }
