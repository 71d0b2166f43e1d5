"""Pipeline of the tables of scores."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.pipelines.compare.nodes import compare_methods


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores of all methods to a table per task."""
    return Pipeline(
        [
            Node(
                compare_methods,
                inputs=[f"{slug}.scores" for slug in methods_of("labelling")],
                outputs="comparison",
                name="compare_methods",
            ),
            Node(
                compare_methods,
                inputs=[f"{slug}.scores" for slug in methods_of("detection")],
                outputs="detection_comparison",
                name="compare_detectors",
            ),
        ]
    )
