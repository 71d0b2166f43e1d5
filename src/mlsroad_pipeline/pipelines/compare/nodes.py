"""Tables of the scores of all methods."""

import pandas as pd

from mlsroad_pipeline.algorithms.metrics.scores import summary


def compare_methods(*scores: pd.DataFrame) -> pd.DataFrame:
    """Return the overall figures of all methods in one table."""
    return summary(pd.concat(scores, ignore_index=True)).reset_index()
