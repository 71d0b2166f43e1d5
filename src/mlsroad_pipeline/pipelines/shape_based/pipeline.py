"""Pipeline of shape-based recognition."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.papers.luo2016.shape_based.labeller import label_objects
from mlsroad_pipeline.papers.luo2016.shape_based.training import training_objects
from mlsroad_pipeline.pipelines.patch_labellers import gathering
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.shape_based.nodes import scheme_of, train_shape_based
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: objects to a model, and to labels of the scenes that it was not trained on."""
    prepared = {"scene": "scenes", "ground": "ground", "patches": "patches"}
    return Pipeline(
        [
            gathering(),
            Node(
                PerScene(training_objects, keys=training_keys, scheme=scheme_of),
                inputs={**prepared, "training": "patch_training", "parameters": "params:shape_based"},
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
                PerScene(label_objects, keys=held_out_keys),
                inputs={**prepared, "bundle": "shape_based.model"},
                outputs="shape_based.labels",
                name="label_scenes_by_shape",
            ),
        ]
    )
