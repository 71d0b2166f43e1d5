"""Pipeline of the report."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.pipelines.per_scene import fix_arguments
from mlsroad_pipeline.pipelines.report.nodes import write_report

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
                inputs=["params:survey", *inputs],
                outputs="report",
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
