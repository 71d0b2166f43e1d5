"""Measures of a segmentation against the reference objects of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import group_by_split
from mlsroad_pipeline.algorithms.metrics.instances import InstanceScores, find_overlaps, score_segmentation
from mlsroad_pipeline.algorithms.segmentation.stage import Segments, owned_by_core, reference_objects

SEGMENTATION_SCORES = (
    "coverage",
    "weighted_coverage",
    "precision",
    "recall",
    "over_segmentation",
    "under_segmentation",
)
"""Columns of scores of `segmentation_table`, in order."""


class SegmentationMeasures(TypedDict):
    """Scores of one scene, as `measure_segmentation` returns them.

    Attributes
    ----------
    scores : ndarray of float64, shape (6,)
        In the order of `SEGMENTATION_SCORES`.
    weights : ndarray of int64, shape (3,)
        Number of instances, number of their points, and number of segments, over which the scores were averaged.
    """

    scores: NDArray[np.float64]
    weights: NDArray[np.int64]


def measure_segmentation(
    scene: PointCloud, objects: Segments, *, scheme: ClassScheme, min_points: int
) -> SegmentationMeasures:
    """Score the objects of a scene against the reference instances that it owns.

    Parameters
    ----------
    scene : PointCloud
        The scene, with `label`.
    objects : Segments
        Object of each point.
    scheme : ClassScheme
        The classes, for surveys without instances.
    min_points : int
        Instances with fewer points are excluded.

    Returns
    -------
    SegmentationMeasures
        Scores and their weights.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    """
    instances, _ = reference_objects(scene, scheme)
    owned = owned_by_core(scene, instances, int(instances.max(initial=0)) + 1)
    mine = np.where(owned[instances], instances, 0)
    scores: InstanceScores = score_segmentation(mine, objects["objects"], min_points=min_points)
    sizes = find_overlaps(mine, objects["objects"]).instance_sizes
    points = int(sizes[sizes >= min_points].sum())
    return {
        "scores": np.array([asdict(scores)[name] for name in SEGMENTATION_SCORES], dtype=np.float64),
        "weights": np.array([scores.n_instances, points, scores.n_segments]),
    }


def segmentation_table(measured: Mapping[str, SegmentationMeasures]) -> pd.DataFrame:
    """Return the segmentation scores of each split: means over scenes, weighted by the denominator of each score.

    Parameters
    ----------
    measured : mapping of str to SegmentationMeasures
        Measures by scene name, which begins with the split and a dot.

    Returns
    -------
    DataFrame
        Columns ``split``, those of `SEGMENTATION_SCORES`, ``n_instances`` and ``n_segments``.
    """
    by = {"coverage": 0, "weighted_coverage": 1, "precision": 2, "recall": 0, "over_segmentation": 0}
    rows: list[dict[str, Any]] = []
    for split, scenes in group_by_split(measured).items():
        scores, weights = np.array([s["scores"] for s in scenes]), np.array([s["weights"] for s in scenes])
        row: dict[str, Any] = {"split": split}
        for column, name in enumerate(SEGMENTATION_SCORES):
            weight = weights[:, by.get(name, 2)] * np.isfinite(scores[:, column])
            total = float((np.nan_to_num(scores[:, column]) * weight).sum())
            row[name] = total / weight.sum() if weight.sum() else np.nan
        rows.append({**row, "n_instances": int(weights[:, 0].sum()), "n_segments": int(weights[:, 2].sum())})
    return pd.DataFrame(rows)
