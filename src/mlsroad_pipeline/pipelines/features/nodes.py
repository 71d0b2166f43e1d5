"""Supervoxel features, scene by scene."""

from mlsroad_pipeline.algorithms.stages import FeatureParameters, describe_supervoxels
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks


def describe_supervoxels_of_scenes(
    scenes: SceneCollection, ground: SceneCollection, supervoxels: SceneCollection, parameters: FeatureParameters
) -> dict[str, SceneTask]:
    """Name the work that computes the features of each scene's supervoxels.

    Parameters
    ----------
    scenes : SceneCollection
        The scenes.
    ground : SceneCollection
        Ground masks and heights, keyed like the scenes.
    supervoxels : SceneCollection
        Supervoxels, keyed like the scenes.
    parameters : FeatureParameters
        Which features, and whether they are detrended.

    Returns
    -------
    dict of str to SceneTask
        One task per scene.
    """
    inputs = {"scene": scenes, "ground": ground, "supervoxels": supervoxels}
    return scene_tasks(scenes, describe_supervoxels, inputs, {"parameters": parameters})
