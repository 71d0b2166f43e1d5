"""Wiring of shape-based recognition."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.patch_method import gathering
from mlsroad_pipeline.pipelines.shape_based.nodes import label_scenes_by_shape, take_training_objects, train_shape_based


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: objects to a model, and to labels of the scenes that it was not trained on."""
    return Pipeline(
        [
            gathering(),
            Node(
                take_training_objects,
                inputs=["scenes", "ground", "patches", "patch_training", "params:shape_based"],
                outputs="shape_based.training_set",
                name="take_training_objects",
            ),
            Node(
                train_shape_based,
                inputs=["patch_training", "params:shape_based", "shape_based.training_set"],
                outputs=["shape_based.model", "shape_based.registered_model"],
                name="train_shape_based",
            ),
            Node(
                label_scenes_by_shape,
                inputs=["scenes", "ground", "patches", "shape_based.model"],
                outputs="shape_based.labels",
                name="label_scenes_by_shape",
            ),
        ]
    )
