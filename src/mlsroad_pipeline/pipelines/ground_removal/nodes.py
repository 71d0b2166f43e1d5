"""Scores of the ground filter."""

import pandas as pd

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.evaluation.stages import ground_table


def score_ground_removal(counts: SceneCollection) -> pd.DataFrame:
    """Score the ground filter per split."""
    return ground_table(counts.load_all())
