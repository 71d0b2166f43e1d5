"""Wiring of the comparison."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.compare.nodes import compare_methods
from mlsroad_pipeline.pipelines.methods import DETECTORS, LABELLERS


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores of every method to one table."""
    return Pipeline(
        [
            Node(
                compare_methods,
                inputs=[f"{slug}.scores" for slug in LABELLERS],
                outputs="comparison",
                name="compare_methods",
            ),
            Node(
                compare_methods,
                inputs=[f"{slug}.scores" for slug in DETECTORS],
                outputs="detection_comparison",
                name="compare_detectors",
            ),
        ]
    )
