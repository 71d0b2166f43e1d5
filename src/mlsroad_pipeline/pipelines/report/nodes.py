"""What a comparison found, on one page."""

from __future__ import annotations

from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.comparison_report import comparison_sections
from mlsroad_pipeline.algorithms.rendering.report import build_report
from mlsroad_pipeline.datasets.survey_parameters import SurveyParameters
from mlsroad_pipeline.pipelines.methods import DETECTORS, LABELLERS


def write_report(
    comparison: pd.DataFrame,
    detection: pd.DataFrame,
    quality: pd.DataFrame,
    ground: pd.DataFrame,
    supervoxels: pd.DataFrame,
    segmentation: pd.DataFrame,
    survey: SurveyParameters,
    *parts: Any,
) -> str:
    """Put scores and figures of all methods on one page.

    Parameters
    ----------
    comparison : DataFrame
        Overall figures of all labellers.
    detection : DataFrame
        Overall figures of all detectors.
    quality : DataFrame
        Quality of each file.
    ground : DataFrame
        Scores of the ground filter.
    supervoxels : DataFrame
        Quality of the partition.
    segmentation : DataFrame
        Scores of the segmentation into objects.
    survey : SurveyParameters
        What was compared on.
    *parts : DataFrame or ndarray
        For each labeller and then each detector, its scores and then its figures.

    Returns
    -------
    str
        HTML.
    """
    n_detectors = 2 * len(DETECTORS)
    width = (len(parts) - n_detectors) // len(LABELLERS)
    methods = {slug: parts[i * width : (i + 1) * width] for i, slug in enumerate(LABELLERS)}
    found = parts[len(parts) - n_detectors :]
    methods |= {slug: found[2 * i : 2 * i + 2] for i, slug in enumerate(DETECTORS)}
    tables = {
        "Ground removal": ground,
        "Supervoxels": supervoxels,
        "Segmentation into objects": segmentation,
        "Quality of the survey": quality,
    }
    facts = {"survey": survey.root, "splits": dict(survey.splits), "classes": survey.evaluation_scheme or survey.scheme}
    return build_report(
        comparison_sections(facts, comparison, detection, tables, methods), title="Comparison of methods"
    )
