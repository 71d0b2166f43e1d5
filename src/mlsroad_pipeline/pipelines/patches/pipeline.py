"""Wiring of the patches."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.patches.nodes import extract_patches_of_scenes, label_patches_of_scenes


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and ground to patches, and to the classes of those of the training scenes."""
    return Pipeline(
        [
            Node(
                extract_patches_of_scenes,
                inputs=["scenes", "ground", "params:patches"],
                outputs="patches",
                name="extract_patches_of_scenes",
            ),
            Node(
                label_patches_of_scenes,
                inputs=["scenes", "patches", "params:survey", "params:classes"],
                outputs="patch_labels",
                name="label_patches_of_scenes",
            ),
        ]
    )
