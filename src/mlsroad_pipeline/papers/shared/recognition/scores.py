"""Scores of recognised objects per split or fold."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.metrics.scores import recognition_scores

ALL_FOLDS = "test"
"""Split of all folds together in cross-validation."""


def score_recognitions(
    truth: Mapping[str, NDArray[np.integer]],
    predicted: Mapping[str, NDArray[np.integer]],
    *,
    method: str,
    scheme: ClassScheme,
    folds: bool,
) -> tuple[pd.DataFrame, dict[str, NDArray[np.int64]]]:
    """Score recognised objects; objects of unknown class are excluded."""
    matrices: dict[str, NDArray[np.int64]] = {}
    for key, labels in truth.items():
        counted = confusion_matrix(labels, predicted[key], len(scheme))
        for split in (key, ALL_FOLDS) if folds else (SceneKey.parse(key).split,):
            matrices[split] = matrices.get(split, 0) + counted
    if folds:
        matrices[ALL_FOLDS] = matrices.pop(ALL_FOLDS)  # last
    tables = [
        recognition_scores(matrix, method=method, split=split, classes=scheme.classes)
        for split, matrix in matrices.items()
    ]
    return pd.concat(tables, ignore_index=True), matrices
