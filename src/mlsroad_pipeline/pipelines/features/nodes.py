"""Supervoxel features, scene by scene."""

from mlsroad_pipeline.algorithms.stages import FeatureParameters, describe_supervoxels
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks


def describe_supervoxels_of_scenes(
    scenes: SceneCollection, ground: SceneCollection, supervoxels: SceneCollection, parameters: FeatureParameters
) -> dict[str, SceneTask]:
    """Name the work that computes the features of each scene's supervoxels."""
    inputs = {"scene": scenes, "ground": ground, "supervoxels": supervoxels}
    return scene_tasks(scenes, describe_supervoxels, inputs, {"parameters": parameters})
