"""Ground removal, scene by scene."""

import pandas as pd

from mlsroad_pipeline.algorithms.evaluation.stages import count_ground_points, ground_table
from mlsroad_pipeline.algorithms.stages import GroundParameters, find_ground
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks


def find_ground_of_scenes(scenes: SceneCollection, parameters: GroundParameters) -> dict[str, SceneTask]:
    """Name the work that tells each scene's ground points and heights above the ground."""
    return scene_tasks(scenes, find_ground, {"scene": scenes}, {"parameters": parameters})


def count_ground_of_scenes(scenes: SceneCollection, ground: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that holds each scene's ground against its labels."""
    return scene_tasks(scenes, count_ground_points, {"scene": scenes, "ground": ground})


def score_ground_removal(counts: SceneCollection) -> pd.DataFrame:
    """Score the ground filter per split."""
    return ground_table(counts.load_all())
