"""Pipeline of the patches."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.papers.shared.patches.labelling import build_patches
from mlsroad_pipeline.pipelines.patches.nodes import label_training_patches
from mlsroad_pipeline.pipelines.per_scene import PerScene


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
                label_training_patches,
                inputs=["scenes", "patches", "corridors", "params:survey", "params:classes"],
                outputs="patch_labels",
                name="label_patches_of_scenes",
            ),
        ]
    )
