"""Pipeline of ground removal."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.shared.evaluation.stages import count_ground_points
from mlsroad_pipeline.pipelines.ground_removal.nodes import score_ground_removal
from mlsroad_pipeline.pipelines.per_scene import PerScene


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes to ground masks and heights, and their scores."""
    return Pipeline(
        [
            Node(
                PerScene(find_ground),
                inputs={"scene": "scenes", "parameters": "params:ground_removal"},
                outputs="ground",
                name="find_ground_of_scenes",
            ),
            Node(
                PerScene(count_ground_points),
                inputs={"scene": "scenes", "ground": "ground"},
                outputs="ground_counts",
                name="count_ground_of_scenes",
            ),
            Node(score_ground_removal, inputs="ground_counts", outputs="ground_scores", name="score_ground_removal"),
        ]
    )
