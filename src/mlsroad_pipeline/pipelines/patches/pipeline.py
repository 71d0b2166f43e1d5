"""Pipeline of the patches."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.patches.labelling import build_patches, label_patches
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.surveys.plan import training_keys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and ground to patches, and to the classes of those of the training scenes."""
    return Pipeline(
        [
            Node(
                PerScene(build_patches),
                inputs={"scene": "scenes", "ground": "ground", "parameters": "params:patches"},
                outputs="patches",
                name="extract_patches_of_scenes",
            ),
            Node(
                PerScene(label_patches, keys=training_keys, scheme=training_scheme),
                inputs={
                    "scene": "scenes",
                    "patches": "patches",
                    "survey": "params:survey",
                    "classes": "params:classes",
                },
                outputs="patch_labels",
                name="label_patches_of_scenes",
            ),
        ]
    )
