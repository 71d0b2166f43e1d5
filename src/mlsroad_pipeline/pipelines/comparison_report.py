"""Report that compares all methods over several test streets."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from kedro.pipeline import Node, Pipeline
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.papers.comparison import streets
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
    joined = [streets.of_methods([scores[slug] for slug in methods]) for methods in METHODS]
    compared = [streets.compare_task(table, task) for table, task in zip(joined, streets.TASKS, strict=True)]
    spent = streets.costs_table(costs, slugs)
    facts = {"survey": survey.root, "splits": dict(survey.splits), "classes": survey.evaluation_scheme or survey.scheme}
    sections = streets.comparison_sections(facts, compared, spent, _headed(pictures))
    means = [streets.mean_scores(table) for table in joined]
    tables = [table for task in compared for table in (task.overview, task.classes, task.differences)]
    return *means, *tables, spent, build_report(sections, title="All methods")


def _headed(pictures: Sequence[NDArray[np.uint8]]) -> dict[str, dict[str, NDArray[np.uint8]]]:
    """Return the pictures of the methods by heading."""
    return {
        "Labels from above: truth, prediction, errors": dict(zip(PICTURED, pictures, strict=False)),
        "Detectors: precision against recall": dict(zip(DETECTORS, pictures[len(PICTURED) :], strict=True)),
    }


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: stored results of `kedro run --env=compare` to one page."""
    parts = [f"{slug}.scores" for methods in METHODS for slug in methods]
    parts += [f"{slug}.birds_eye_figure" for slug in PICTURED]
    parts += [f"{slug}.precision_recall_figure" for slug in DETECTORS]
    tables = [f"{task.name}_{table}" for task in streets.TASKS for table in ("overview", "classes", "differences")]
    outputs = [*(f"{task.name}_scores" for task in streets.TASKS), *tables, "costs", "report"]
    return Pipeline(
        [
            Node(
                compare_over_streets,
                ["stage_costs", "params:survey", *parts],
                [f"all_methods.{name}" for name in outputs],
                name="compare_over_streets",
            )
        ]
    )
