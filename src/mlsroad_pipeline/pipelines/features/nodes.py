"""Supervoxel features, scene by scene."""

from mlsroad_pipeline.algorithms.scene_stages import FeatureParameters, describe_supervoxels
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.scene_task import SceneTask


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
    return {
        key: SceneTask(
            describe_supervoxels,
            {"scene": scenes[key], "ground": ground[key], "supervoxels": supervoxels[key]},
            {"parameters": parameters},
        )
        for key in scenes
    }
