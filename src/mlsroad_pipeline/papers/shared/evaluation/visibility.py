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
    """Return the confusion matrices of a scene over all core points and over the visible ones.

    Parameters
    ----------
    scene : PointCloud
        The scene, with `label` and `core`.
    labels : mapping
        ``seen`` bool (n,), and the labels of `trained` under the names of `answers`, int16 (n,).
    answers : LabelNames
        Method to the name of its labels in `labels`.
    trained, scored : ClassScheme
        The schemes.

    Returns
    -------
    dict of str to ndarray
        Method to its matrices, int64 (2, C, C + 1): of all core points, of the visible ones.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    UnknownClassError
        If a label is not in the scheme.
    """
    parts = (scene["core"], scene["core"] & labels["seen"])
    return {
        method: np.stack([count_labels(scene, labels[name], part, trained=trained, scored=scored) for part in parts])
        for method, name in answers.items()
    }


def seen_scores_table(
    counted: Mapping[str, Mapping[str, NDArray]], *, scheme: ClassScheme, suffix: str = ""
) -> tuple[pd.DataFrame, dict[str, dict[str, NDArray[np.int64]]]]:
    """Return the scores of methods on all splits, over all points and over the visible ones.

    Parameters
    ----------
    counted : mapping of str to mapping
        Key of the scene to the matrices of each method, see `count_seen_scene`.
    scheme : ClassScheme
        The scheme of the matrices.
    suffix : str, default ""
        Suffix of the names of the splits.

    Returns
    -------
    table : DataFrame
        Table of scores; splits of the visible points end in ``_visible``.
    matrices : dict of str to dict
        Method to split to its confusion matrix over all points.
    """
    tables, matrices = [], {}
    for method in next(iter(counted.values())):
        total = sum_by_split({key: {"matrix": matrix[method]} for key, matrix in counted.items()})
        every = {f"{split}{suffix}": both[0] for split, both in total.items()}
        visible = {f"{split}{suffix}_visible": both[1] for split, both in total.items()}
        tables.append(scores_table(every | visible, method=method, scheme=scheme))
        matrices[method] = every
    return pd.concat(tables, ignore_index=True), matrices


def seen_share(table: pd.DataFrame, split: str) -> str:
    """Return a log message with the number of points of a split outside all images.

    Parameters
    ----------
    table : DataFrame
        The scores of one method.
    split : str
        The split.

    Returns
    -------
    str
        The message.
    """
    overall = table[(table["class"] == "all") & (table["metric"] == "overall_accuracy")].set_index("split")["support"]
    every, seen = int(overall[split]), int(overall[f"{split}_visible"])
    return f"no camera sees {every - seen} of the {every} scored points of {split}"
