"""Quality of the partition into supervoxels."""

import pandas as pd

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.evaluation.stages import supervoxel_table


def score_supervoxels(measured: SceneCollection) -> pd.DataFrame:
    """Score the partition per split."""
    return supervoxel_table(measured.load_all())
