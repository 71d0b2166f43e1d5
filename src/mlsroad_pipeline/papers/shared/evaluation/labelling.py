"""Confusion matrices of labelled scenes per split, at full resolution and over core points only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.labels import PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores


def coarse_labels(label: NDArray[np.integer], trained: ClassScheme, scored: ClassScheme) -> NDArray[np.int16]:
    """Convert labels of the training scheme of a method to labels of the scoring scheme."""
    if trained == scored:
        return label.astype(np.int16)
    table = np.append(trained.coarsen(scored), np.int16(IGNORE))  # -1 indexes the last entry
    return table[label]


class SceneMatrix(TypedDict):
    """Confusion matrix of a scene."""

    # Points by true and predicted class, see `confusion_matrix`; k matrices for k sets of points
    matrix: NDArray[np.int64]


def count_scene(scene: PointCloud, labels: PointLabels, *, trained: ClassScheme, scored: ClassScheme) -> SceneMatrix:
    """Return the confusion matrix of the core points of a scene."""
    return {"matrix": count_labels(scene, labels["label"], scene["core"], trained=trained, scored=scored)}


def count_labels(
    scene: PointCloud,
    label: NDArray[np.integer],
    counted: NDArray[np.bool_],
    *,
    trained: ClassScheme,
    scored: ClassScheme,
) -> NDArray[np.int64]:
    """Return the confusion matrix of some points of a scene."""
    truth = scored.encode(scene["label"][counted], source=scene.source)
    return confusion_matrix(truth, coarse_labels(label[counted], trained, scored), len(scored))


def sum_by_split(matrices: Mapping[str, SceneMatrix]) -> dict[str, NDArray[np.int64]]:
    """Return the sum of the confusion matrices of each split."""
    total: dict[str, NDArray[np.int64]] = {}
    for key, counted in matrices.items():
        split = SceneKey.parse(key).split
        total[split] = total.get(split, 0) + counted["matrix"]
    return total


def given_classes(metadata: Mapping[str, Any], trained: ClassScheme, scored: ClassScheme) -> list[str]:
    """Return the classes that a model can predict, in the scoring scheme."""
    if "classes_given" not in metadata:
        return list(scored.classes)
    own = np.array([trained.classes.index(name) for name in metadata["classes_given"]], np.int16)
    return [scored.classes[label] for label in np.unique(coarse_labels(own, trained, scored)) if label != IGNORE]


def scores_table(
    matrices: Mapping[str, NDArray[np.int64]], *, method: str, scheme: ClassScheme, given: Sequence[str] | None = None
) -> pd.DataFrame:
    """Return the scores of a method on all splits."""
    tables = [
        labelling_scores(matrix, method=method, split=split, classes=scheme.classes, given=given)
        for split, matrix in matrices.items()
    ]
    return pd.concat(tables, ignore_index=True)
