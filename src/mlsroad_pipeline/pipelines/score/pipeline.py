"""Pipeline of the scores of an inventory."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.score.nodes import score_objects_of_inventory


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from an inventory and a table of true objects to scores and pictures of the worst objects."""
    return Pipeline(
        [
            Node(
                score_objects_of_inventory,
                inputs="params:score",
                outputs=[
                    "object_scores_record",
                    "object_scores",
                    "object_curve",
                    "object_measures",
                    "object_outcomes",
                    "true_object_outcomes",
                    "object_scores_page",
                ],
                name="score_objects_of_inventory",
            )
        ]
    )
