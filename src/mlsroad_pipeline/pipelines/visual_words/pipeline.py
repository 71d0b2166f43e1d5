"""Wiring of the visual words."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.visual_words.nodes import (
    describe_objects_of_scenes,
    detect_objects_of_scenes,
    train_visual_words,
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
        ``scenes``, ``objects`` and ``object_classes`` to ``visual_words.model`` and ``visual_words.detections``.
    """
    return Pipeline(
        [
            Node(
                describe_objects_of_scenes,
                inputs=["scenes", "objects", "params:visual_words"],
                outputs="visual_words.groups",
                name="describe_objects_of_scenes",
            ),
            Node(
                train_visual_words,
                inputs=[
                    "visual_words.groups",
                    "object_classes",
                    "params:visual_words",
                    "params:ground_removal",
                    "params:segmentation",
                    "params:detection",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["visual_words.model", "visual_words.registered_model"],
                name="train_visual_words",
            ),
            Node(
                detect_objects_of_scenes,
                inputs=["visual_words.groups", "visual_words.model"],
                outputs="visual_words.detections",
                name="detect_objects_of_scenes",
            ),
        ]
    )
