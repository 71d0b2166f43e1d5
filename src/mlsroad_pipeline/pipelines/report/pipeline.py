"""Wiring of the report."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.methods import DETECTORS, LABELLERS
from mlsroad_pipeline.pipelines.report.nodes import write_report

FIGURES = ("birds_eye", "perspective", "confusion", "bars")
DETECTOR_FIGURES = ("precision_recall",)


def _parts(slug: str, figures: tuple[str, ...]) -> list[str]:
    return [f"{slug}.scores", *(f"{slug}.{figure}_figure" for figure in figures)]


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores and figures of every method to one page.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``<slug>.scores`` and figures of every method and the tables of the stages to ``report``.
    """
    parts = [name for slug in LABELLERS for name in _parts(slug, FIGURES)]
    parts += [name for slug in DETECTORS for name in _parts(slug, DETECTOR_FIGURES)]
    tables = ["comparison", "detection_comparison"]
    tables += ["survey_quality", "ground_scores", "supervoxel_quality", "segmentation_scores"]
    return Pipeline(
        [Node(write_report, inputs=[*tables, "params:survey", *parts], outputs="report", name="write_report")]
    )
