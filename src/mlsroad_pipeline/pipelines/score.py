"""Pipeline that scores an inventory against a table of true objects."""

from typing import Any

import pandas as pd
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.label.object_scoring import ScoreParameters, score_inventory, score_record
from mlsroad_pipeline.label.worst_objects import worst_pictures
from mlsroad_pipeline.reporting.score_page import score_page


def score_objects_of_inventory(parameters: ScoreParameters) -> tuple[dict[str, Any], *tuple[pd.DataFrame, ...], str]:
    """Return the scores as JSON and as tables (by kind, by threshold, of measures, outcomes), and their page."""
    scored = score_inventory(parameters)
    tables = (scored.scores, scored.curve, scored.measures, scored.matched.objects, scored.matched.truth)
    facts = {"inventory": parameters.inventory, "truth": parameters.truth, "kind of truth": scored.source}
    page = score_page(facts, scored.scores, scored.curve, scored.measures, worst_pictures(scored))
    return score_record(scored, parameters), *tables, page


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from an inventory and a table of true objects to scores and pictures of the worst objects."""
    return Pipeline(
        [
            Node(
                score_objects_of_inventory,
                "params:score",
                [
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
