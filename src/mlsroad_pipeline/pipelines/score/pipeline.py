"""Pipeline of the scores of an inventory."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.score.nodes import score_objects_of_inventory, write_score_page


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from an inventory and a table of true objects to scores and pictures of the worst objects."""
    return Pipeline(
        [
            Node(
                score_objects_of_inventory,
                inputs="params:score",
                outputs=[
                    "scored_inventory",
                    "object_scores_record",
                    "object_scores",
                    "object_curve",
                    "object_measures",
                    "object_outcomes",
                    "true_object_outcomes",
                ],
                name="score_objects_of_inventory",
            ),
            Node(
                write_score_page,
                inputs=["scored_inventory", "params:score"],
                outputs="object_scores_page",
                name="write_score_page",
            ),
        ]
    )
