"""Wiring of the segmentation."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.segmentation.nodes import (
    measure_segmentation_of_scenes,
    name_objects_of_scenes,
    score_segmentation,
    segment_scenes,
)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and their ground to objects."""
    configured = ["params:detection", "params:classes"]
    return Pipeline(
        [
            Node(
                segment_scenes,
                inputs=["scenes", "ground", "params:segmentation"],
                outputs="objects",
                name="segment_scenes",
            ),
            Node(
                name_objects_of_scenes,
                inputs=["scenes", "objects", *configured],
                outputs="object_classes",
                name="name_objects_of_scenes",
            ),
            Node(
                measure_segmentation_of_scenes,
                inputs=["scenes", "objects", *configured],
                outputs="segmentation_quality_of_scenes",
                name="measure_segmentation_of_scenes",
            ),
            Node(
                score_segmentation,
                inputs="segmentation_quality_of_scenes",
                outputs="segmentation_scores",
                name="score_segmentation",
            ),
        ]
    )
