"""Wiring of ground removal."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.ground_removal.nodes import (
    count_ground_of_scenes,
    find_ground_of_scenes,
    score_ground_removal,
)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes to ground masks and heights."""
    return Pipeline(
        [
            Node(
                find_ground_of_scenes,
                inputs=["scenes", "params:ground_removal"],
                outputs="ground",
                name="find_ground_of_scenes",
            ),
            Node(
                count_ground_of_scenes,
                inputs=["scenes", "ground"],
                outputs="ground_counts",
                name="count_ground_of_scenes",
            ),
            Node(score_ground_removal, inputs="ground_counts", outputs="ground_scores", name="score_ground_removal"),
        ]
    )
