"""All methods side by side."""

import pandas as pd

from mlsroad_pipeline.algorithms.metrics.scores import summary


def compare_methods(*scores: pd.DataFrame) -> pd.DataFrame:
    """Put the overall figures of all methods into one table."""
    return summary(pd.concat(scores, ignore_index=True)).reset_index()
