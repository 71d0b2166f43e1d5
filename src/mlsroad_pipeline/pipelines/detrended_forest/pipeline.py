"""Wiring of the detrended forest."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.detrended_forest.nodes import label_scenes, take_training_rows, train_forest


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: features to a model, and to labels of the scenes that it was not trained on."""
    return Pipeline(
        [
            Node(
                take_training_rows,
                inputs=["scenes", "supervoxels", "supervoxel_features", "params:survey", "params:classes"],
                outputs="detrended_forest.training_set",
                name="take_training_rows",
            ),
            Node(
                train_forest,
                inputs=[
                    "detrended_forest.training_set",
                    "params:detrended_forest",
                    "params:ground_removal",
                    "params:supervoxelise",
                    "params:features",
                    "params:survey",
                    "params:classes",
                ],
                outputs=[
                    "detrended_forest.model",
                    "detrended_forest.registered_model",
                    "detrended_forest.importance_figure",
                    "detrended_forest.oob_figure",
                ],
                name="train_forest",
            ),
            Node(
                label_scenes,
                inputs=["scenes", "supervoxels", "supervoxel_features", "detrended_forest.model"],
                outputs="detrended_forest.labels",
                name="label_scenes",
            ),
        ]
    )
