"""Wiring of the object matching."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.object_matching.nodes import (
    describe_objects_of_object_matching,
    detect_by_object_matching,
    train_object_matching,
)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: objects to a model, and to detections in the scenes that it was not trained on.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``scenes``, ``objects`` and ``object_classes`` to ``object_matching.model`` and ``object_matching.detections``.
    """
    return Pipeline(
        [
            Node(
                describe_objects_of_object_matching,
                inputs=["scenes", "objects", "params:object_matching"],
                outputs="object_matching.parts",
                name="describe_objects_of_object_matching",
            ),
            Node(
                train_object_matching,
                inputs=[
                    "object_matching.parts",
                    "object_classes",
                    "params:object_matching",
                    "params:ground_removal",
                    "params:segmentation",
                    "params:detection",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["object_matching.model", "object_matching.registered_model"],
                name="train_object_matching",
            ),
            Node(
                detect_by_object_matching,
                inputs=["object_matching.parts", "object_matching.model"],
                outputs="object_matching.detections",
                name="detect_by_object_matching",
            ),
        ]
    )
