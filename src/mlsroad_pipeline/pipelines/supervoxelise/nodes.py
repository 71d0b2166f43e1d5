"""Supervoxels, scene by scene."""

import pandas as pd

from mlsroad_pipeline.algorithms.evaluation.stages import measure_supervoxels, supervoxel_table
from mlsroad_pipeline.algorithms.stages import SupervoxelParameters, build_supervoxels
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks


def supervoxelise_scenes(scenes: SceneCollection, parameters: SupervoxelParameters) -> dict[str, SceneTask]:
    """Name the work that partitions each scene into supervoxels."""
    return scene_tasks(scenes, build_supervoxels, {"scene": scenes}, {"parameters": parameters})


def measure_supervoxels_of_scenes(scenes: SceneCollection, supervoxels: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that measures each scene's partition against its labels."""
    return scene_tasks(scenes, measure_supervoxels, {"scene": scenes, "supervoxels": supervoxels})


def score_supervoxels(measured: SceneCollection) -> pd.DataFrame:
    """Score the partition per split."""
    return supervoxel_table(measured.load_all())
