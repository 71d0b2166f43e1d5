"""What a comparison found, on one page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.comparison_report import comparison_sections
from mlsroad_pipeline.algorithms.rendering.report import build_report
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters
from mlsroad_pipeline.pipelines.methods import LABELLERS


def write_report(
    comparison: pd.DataFrame,
    quality: pd.DataFrame,
    ground: pd.DataFrame,
    supervoxels: pd.DataFrame,
    survey: SurveyParameters,
    *parts: Any,
) -> str:
    """Put scores and figures of all methods on one page.

    Parameters
    ----------
    comparison : DataFrame
        Overall figures of all methods.
    quality : DataFrame
        Quality of each file.
    ground : DataFrame
        Scores of the ground filter.
    supervoxels : DataFrame
        Quality of the partition.
    survey : SurveyParameters
        What was compared on.
    *parts : DataFrame or ndarray
        For each method, its scores and then its figures.

    Returns
    -------
    str
        HTML.
    """
    width = len(parts) // len(LABELLERS)
    methods: Mapping[str, tuple[Any, ...]] = {
        slug: parts[i * width : (i + 1) * width] for i, slug in enumerate(LABELLERS)
    }
    tables = {"Ground removal": ground, "Supervoxels": supervoxels, "Quality of the survey": quality}
    facts = {"survey": survey.root, "splits": dict(survey.splits), "classes": survey.evaluation_scheme or survey.scheme}
    return build_report(comparison_sections(facts, comparison, tables, methods), title="Comparison of methods")
