"""Wiring of the report."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.methods import LABELLERS
from mlsroad_pipeline.pipelines.report.nodes import write_report

FIGURES = ("birds_eye", "perspective", "confusion", "bars")


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores and figures of every method to one page.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``<slug>.scores`` and figures of every labeller and the tables of the stages to ``report``.
    """
    parts = [name for slug in LABELLERS for name in (f"{slug}.scores", *(f"{slug}.{f}_figure" for f in FIGURES))]
    tables = ["comparison", "survey_quality", "ground_scores", "supervoxel_quality"]
    return Pipeline(
        [Node(write_report, inputs=[*tables, "params:survey", *parts], outputs="report", name="write_report")]
    )
