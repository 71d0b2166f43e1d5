"""Wiring of the Hough forest."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.hough_forest.nodes import (
    describe_objects_of_hough_forest,
    detect_by_hough_forest,
    train_hough_forest,
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
        ``scenes``, ``objects`` and ``object_classes`` to ``hough_forest.model`` and ``hough_forest.detections``.
    """
    return Pipeline(
        [
            Node(
                describe_objects_of_hough_forest,
                inputs=["scenes", "objects", "params:hough_forest"],
                outputs="hough_forest.parts",
                name="describe_objects_of_hough_forest",
            ),
            Node(
                train_hough_forest,
                inputs=[
                    "hough_forest.parts",
                    "object_classes",
                    "params:hough_forest",
                    "params:ground_removal",
                    "params:segmentation",
                    "params:detection",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["hough_forest.model", "hough_forest.registered_model"],
                name="train_hough_forest",
            ),
            Node(
                detect_by_hough_forest,
                inputs=["hough_forest.parts", "hough_forest.model"],
                outputs="hough_forest.detections",
                name="detect_by_hough_forest",
            ),
        ]
    )
