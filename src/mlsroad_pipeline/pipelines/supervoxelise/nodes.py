"""Quality of the partition into supervoxels."""

import pandas as pd

from mlsroad_pipeline.algorithms.evaluation.stages import supervoxel_table
from mlsroad_pipeline.execution.collection import SceneCollection


def score_supervoxels(measured: SceneCollection) -> pd.DataFrame:
    """Score the partition per split."""
    return supervoxel_table(measured.load_all())
