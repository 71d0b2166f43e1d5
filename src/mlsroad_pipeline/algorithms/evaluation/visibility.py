"""Scores of methods that use images: over all points, and over those that a camera sees."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.evaluation.labelling import count_scene, scores_table, sum_by_split


def count_seen_scene(
    scene: PointCloud,
    labels: Mapping[str, NDArray],
    *,
    answers: Mapping[str, str],
    trained: ClassScheme,
    scored: ClassScheme,
) -> dict[str, NDArray]:
    """Count the core points of a scene, all of them and those that cameras see.

    Parameters
    ----------
    scene : PointCloud
        The scene, with `label` and `core`.
    labels : mapping
        ``seen`` bool (n,), and the labels of `trained` that `answers` names, int16 (n,).
    answers : mapping of str to str
        Method to the name of its labels.
    trained, scored : ClassScheme
        The schemes.

    Returns
    -------
    dict of str to ndarray
        Method to its matrices, int64 (2, C, C + 1): of all points, of those that cameras see.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    UnknownClassError
        If a label is not in the scheme.
    """
    kept = (scene["core"], scene["core"] & labels["seen"])
    given = {method: {"label": labels[name]} for method, name in answers.items()}
    parts = [scene.with_columns(core=rows) for rows in kept]
    return {
        method: np.stack([count_scene(part, mine, trained=trained, scored=scored)["matrix"] for part in parts])
        for method, mine in given.items()
    }


def seen_scores_table(
    counted: Mapping[str, Mapping[str, NDArray]], *, scheme: ClassScheme, suffix: str = ""
) -> tuple[pd.DataFrame, dict[str, dict[str, NDArray[np.int64]]]]:
    """Score methods on all splits, over all points and over those that cameras see.

    Parameters
    ----------
    counted : mapping of str to mapping
        Scene name, which begins with its split and a dot, to what `count_seen_scene` gave.
    scheme : ClassScheme
        The scheme of the matrices.
    suffix : str, default ""
        What is appended to the names of the splits.

    Returns
    -------
    table : DataFrame
        The table of scores; of the points that cameras see, the split's name ends in ``_visible``.
    matrices : dict of str to dict
        Method to split to its confusion matrix over all points.
    """
    tables, matrices = [], {}
    for method in next(iter(counted.values())):
        total = sum_by_split({key: {"matrix": given[method]} for key, given in counted.items()})
        every = {f"{split}{suffix}": both[0] for split, both in total.items()}
        visible = {f"{split}{suffix}_visible": both[1] for split, both in total.items()}
        tables.append(scores_table(every | visible, method=method, scheme=scheme))
        matrices[method] = every
    return pd.concat(tables, ignore_index=True), matrices


def seen_share(table: pd.DataFrame, split: str) -> str:
    """Say how many points of a split cameras see.

    Parameters
    ----------
    table : DataFrame
        The scores of one method.
    split : str
        The split.

    Returns
    -------
    str
        A sentence for the log.
    """
    overall = table[(table["class"] == "all") & (table["metric"] == "overall_accuracy")].set_index("split")["support"]
    every, seen = int(overall[split]), int(overall[f"{split}_visible"])
    return f"no camera sees {every - seen} of the {every} scored points of {split}"
