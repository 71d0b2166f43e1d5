"""Tables of the scores of all methods."""

import pandas as pd
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.metrics.scores import summary
from mlsroad_pipeline.algorithms.models.methods import methods_of


def compare_methods(*scores: pd.DataFrame) -> pd.DataFrame:
    """Return the overall figures of all methods in one table."""
    return summary(pd.concat(scores, ignore_index=True)).reset_index()


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores of all methods to a table per task."""
    return Pipeline(
        [
            Node(
                compare_methods,
                [f"{slug}.scores" for slug in methods_of("labelling")],
                "comparison",
                name="compare_methods",
            ),
            Node(
                compare_methods,
                [f"{slug}.scores" for slug in methods_of("detection")],
                "detection_comparison",
                name="compare_detectors",
            ),
        ]
    )
