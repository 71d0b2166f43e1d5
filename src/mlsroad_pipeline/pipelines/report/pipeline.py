"""Wiring of the report."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.methods import DETECTORS, IMAGE_METHODS, LABELLERS, RECOGNISERS, fix_arguments
from mlsroad_pipeline.pipelines.report.nodes import write_report

LABEL_FIGURES = ("birds_eye", "perspective", "confusion", "bars")
TASKS = {
    "comparison": (LABELLERS, LABEL_FIGURES),
    "image_comparison": (IMAGE_METHODS, LABEL_FIGURES),
    "detection_comparison": (DETECTORS, ("precision_recall", "detections")),
    "recognition_comparison": (RECOGNISERS, ("confusion",)),
}
"""The table of each task to its methods and the figures that each of them has."""
STAGES = ("survey_quality", "ground_scores", "supervoxel_quality", "segmentation_scores")


def _report(*tasks: str) -> Pipeline:
    """Return the pipeline that writes a report on some tasks."""
    figures = {slug: TASKS[task][1] for task in tasks for slug in TASKS[task][0]}
    of_methods = [
        f"{slug}.{part}" for slug, names in figures.items() for part in ("scores", *(f"{n}_figure" for n in names))
    ]
    names = [*tasks, *STAGES, *of_methods]
    return Pipeline(
        [
            Node(
                fix_arguments(write_report, tasks=tasks, figures=figures, names=names),
                inputs=["params:survey", *names],
                outputs="report",
                name="write_report",
            )
        ]
    )


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores and figures of every labeller and detector to one page."""
    return _report("comparison", "detection_comparison")


def report_on_everything() -> Pipeline:
    """Return the pipeline that has the recognisers and the methods that need images on the page too."""
    return _report(*TASKS)
