"""Supervoxel features, with and without detrending."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.stages import describe_supervoxels
from mlsroad_pipeline.pipelines.per_scene import PerScene


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes, ground and supervoxels to features."""
    return Pipeline(
        [
            Node(
                PerScene(describe_supervoxels),
                {"scene": "scenes", "ground": "ground", "supervoxels": "supervoxels", "parameters": "params:features"},
                "supervoxel_features",
                name="describe_supervoxels_of_scenes",
            )
        ]
    )
