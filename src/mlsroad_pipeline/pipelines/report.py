"""Report of a comparison on one page."""

from collections.abc import Mapping, Sequence
from typing import Any

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.pipelines.per_scene import fix_arguments
from mlsroad_pipeline.reporting.comparison_page import comparison_sections
from mlsroad_pipeline.reporting.html.report import build_report
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def write_report(
    survey: SurveyParameters,
    *parts: Any,
    tasks: Sequence[str],
    figures: Mapping[str, Sequence[str]],
    names: Sequence[str],
) -> str:
    """Write the scores and figures of all methods on one page."""
    values = dict(zip(names, parts, strict=True))
    methods = {slug: {name: values[f"{slug}.{name}_figure"] for name in mine} for slug, mine in figures.items()}
    scores = {slug: values[f"{slug}.scores"] for slug in figures}
    facts = {"survey": survey.root, "splits": dict(survey.splits), "classes": survey.evaluation_scheme or survey.scheme}
    tables = {name: table for name, table in values.items() if "." not in name}
    return build_report(comparison_sections(facts, tables, scores, methods, tasks=tasks), title="Comparison of methods")


LABEL_FIGURES = ("birds_eye", "perspective", "confusion", "bars")
STAGES = ("survey_quality", "ground_scores", "supervoxel_quality", "segmentation_scores")


def _tables() -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the table of scores of each task: its methods, and the figures of each method."""
    return {
        "comparison": (methods_of("labelling"), LABEL_FIGURES),
        "image_comparison": (methods_of("labelling", needs_images=True), LABEL_FIGURES),
        "detection_comparison": (methods_of("detection"), ("precision_recall", "detections")),
        "recognition_comparison": (methods_of("recognition"), ("confusion",)),
    }


def _report(*names: str) -> Pipeline:
    """Return the pipeline that writes a report on some tables, or on all."""
    tables = {name: table for name, table in _tables().items() if not names or name in names}
    figures = {slug: drawn for slugs, drawn in tables.values() for slug in slugs}
    of_methods = [
        f"{slug}.{part}" for slug, drawn in figures.items() for part in ("scores", *(f"{n}_figure" for n in drawn))
    ]
    inputs = [*tables, *STAGES, *of_methods]
    return Pipeline(
        [
            Node(
                fix_arguments(write_report, tasks=tuple(tables), figures=figures, names=inputs),
                ["params:survey", *inputs],
                "report",
                name="write_report",
            )
        ]
    )


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores and figures of every labeller and detector to one page."""
    return _report("comparison", "detection_comparison")


def report_on_everything() -> Pipeline:
    """Return the pipeline: scores and figures of all methods to one page."""
    return _report()
