"""Ground points and heights above the ground, scored on labelled surveys."""

import pandas as pd
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.evaluation import count_ground_points, ground_table
from mlsroad_pipeline.pipelines.per_scene import PerScene


def score_ground_removal(counts: SceneCollection) -> pd.DataFrame:
    """Score the ground filter per split."""
    return ground_table(counts.load_all())


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes to ground masks and heights, and their scores."""
    return Pipeline(
        [
            Node(
                PerScene(find_ground),
                {"scene": "scenes", "parameters": "params:ground_removal"},
                "ground",
                name="find_ground_of_scenes",
            ),
            Node(
                PerScene(count_ground_points),
                {"scene": "scenes", "ground": "ground"},
                "ground_counts",
                name="count_ground_of_scenes",
            ),
            Node(score_ground_removal, "ground_counts", "ground_scores", name="score_ground_removal"),
        ]
    )
