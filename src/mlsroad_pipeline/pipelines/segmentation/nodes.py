"""Scores of the segmentation."""

from __future__ import annotations

import pandas as pd

from mlsroad_pipeline.algorithms.segmentation.stage import segmentation_table
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters


def min_points(parameters: DetectionParameters) -> int:
    """Return the least number of points of a reference object."""
    return parameters.min_points


def score_segmentation(measured: SceneCollection) -> pd.DataFrame:
    """Score the segmentation per split."""
    return segmentation_table(measured.load_all())
