"""Wiring of the bottom-up and top-down descriptors."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.bottom_up_top_down.nodes import (
    describe_objects_of_bottom_up_top_down,
    detect_by_bottom_up_top_down,
    train_bottom_up_top_down,
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
        ``scenes``, ``objects`` and ``object_classes`` to ``bottom_up_top_down.model`` and its ``detections``.
    """
    return Pipeline(
        [
            Node(
                describe_objects_of_bottom_up_top_down,
                inputs=["scenes", "objects", "params:bottom_up_top_down"],
                outputs="bottom_up_top_down.parts",
                name="describe_objects_of_bottom_up_top_down",
            ),
            Node(
                train_bottom_up_top_down,
                inputs=[
                    "bottom_up_top_down.parts",
                    "object_classes",
                    "params:bottom_up_top_down",
                    "params:ground_removal",
                    "params:segmentation",
                    "params:detection",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["bottom_up_top_down.model", "bottom_up_top_down.registered_model"],
                name="train_bottom_up_top_down",
            ),
            Node(
                detect_by_bottom_up_top_down,
                inputs=["bottom_up_top_down.parts", "bottom_up_top_down.model"],
                outputs="bottom_up_top_down.detections",
                name="detect_by_bottom_up_top_down",
            ),
        ]
    )
