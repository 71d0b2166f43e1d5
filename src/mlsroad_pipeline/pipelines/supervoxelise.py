"""Supervoxels of scenes, and the quality of the partition."""

import pandas as pd
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.stages import build_supervoxels
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.evaluation import measure_supervoxels, supervoxel_table
from mlsroad_pipeline.pipelines.per_scene import PerScene


def score_supervoxels(measured: SceneCollection) -> pd.DataFrame:
    """Score the partition per split."""
    return supervoxel_table(measured.load_all())


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes to supervoxels, and the quality of the partition."""
    return Pipeline(
        [
            Node(
                PerScene(build_supervoxels),
                {"scene": "scenes", "parameters": "params:supervoxelise"},
                "supervoxels",
                name="supervoxelise_scenes",
            ),
            Node(
                PerScene(measure_supervoxels),
                {"scene": "scenes", "supervoxels": "supervoxels"},
                "supervoxel_quality_of_scenes",
                name="measure_supervoxels_of_scenes",
            ),
            Node(score_supervoxels, "supervoxel_quality_of_scenes", "supervoxel_quality", name="score_supervoxels"),
        ]
    )
