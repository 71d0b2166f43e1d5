"""Pipeline of the detrended forest."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_scene
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import training_rows
from mlsroad_pipeline.pipelines.detrended_forest.nodes import train_forest
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import FACTS, describing
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: features to a model, and to labels of the scenes that it was not trained on."""
    prepared = {"scene": "scenes", "supervoxels": "supervoxels", "features": "supervoxel_features"}
    return Pipeline(
        [
            describing(),
            Node(
                PerScene(training_rows, keys=training_keys, scheme=training_scheme),
                inputs={**prepared, "survey": "params:survey", "classes": "params:classes"},
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
                    FACTS,
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
                PerScene(label_scene, keys=held_out_keys),
                inputs={**prepared, "bundle": "detrended_forest.model"},
                outputs="detrended_forest.labels",
                name="label_scenes",
            ),
        ]
    )
