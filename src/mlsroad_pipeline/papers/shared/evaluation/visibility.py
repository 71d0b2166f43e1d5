"""Scores of methods that use images, over all points and over the points visible in images."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.shared.evaluation.labelling import count_labels, scores_table, sum_by_split

LabelNames = Mapping[str, str]
"""Method to the name of its labels in the stored labels of a scene."""


def count_seen_scene(
    scene: PointCloud,
    labels: Mapping[str, NDArray],
    *,
    answers: LabelNames,
    trained: ClassScheme,
    scored: ClassScheme,
) -> dict[str, NDArray[np.int64]]:
    """Return the confusion matrices of a scene over all core points and over the visible ones."""
    parts = (scene["core"], scene["core"] & labels["seen"])
    return {
        method: np.stack([count_labels(scene, labels[name], part, trained=trained, scored=scored) for part in parts])
        for method, name in answers.items()
    }


def seen_scores_table(
    counted: Mapping[str, Mapping[str, NDArray]], *, scheme: ClassScheme, suffix: str = ""
) -> tuple[pd.DataFrame, dict[str, dict[str, NDArray[np.int64]]]]:
    """Return the scores of methods on all splits, over all points and over the visible ones."""
    tables, matrices = [], {}
    for method in next(iter(counted.values())):
        total = sum_by_split({key: {"matrix": matrix[method]} for key, matrix in counted.items()})
        every = {f"{split}{suffix}": both[0] for split, both in total.items()}
        visible = {f"{split}{suffix}_visible": both[1] for split, both in total.items()}
        tables.append(scores_table(every | visible, method=method, scheme=scheme))
        matrices[method] = every
    return pd.concat(tables, ignore_index=True), matrices


def seen_share(table: pd.DataFrame, split: str) -> str:
    """Return a log message with the number of points of a split outside all images."""
    overall = table[(table["class"] == "all") & (table["metric"] == "overall_accuracy")].set_index("split")["support"]
    every, seen = int(overall[split]), int(overall[f"{split}_visible"])
    return f"no camera sees {every - seen} of the {every} scored points of {split}"
