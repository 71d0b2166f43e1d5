"""Scores of the shared stages on labelled surveys: ground removal and supervoxels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import group_by_split
from mlsroad_pipeline.algorithms.core.stage_results import GroundMask, SupervoxelPartition
from mlsroad_pipeline.algorithms.metrics.ground import count_ground, scores_of_counts
from mlsroad_pipeline.algorithms.metrics.partition import evaluate_partition
from mlsroad_pipeline.algorithms.stages import inliers

GROUND_CLASSES = (
    "road",
    "lane_marking",
    "parking",
    "sidewalk",
    "curb",
    "manhole",
    "trail",
    "grass",
    "soil",
    "other_ground",
)
"""Taxonomy classes of ground points."""

UNSCORED = ("unlabelled", "outlier")

SUPERVOXEL_SCORES = ("boundary_recall", "under_segmentation_error", "accuracy_ceiling")


class GroundCounts(TypedDict):
    """Counts of a ground filter on a scene."""

    counts: NDArray[np.int64]  # See `count_ground`


class SupervoxelQuality(TypedDict):
    """Quality of the supervoxels of a scene."""

    quality: NDArray[np.float64]  # The scores of `SUPERVOXEL_SCORES`; NaN where undefined
    weights: NDArray[np.int64]  # Numbers of scored points and of supervoxels


def count_ground_points(scene: PointCloud, ground: GroundMask) -> GroundCounts:
    """Count the core points of a scene by true and predicted ground."""
    label = scene["label"]
    truth = np.isin(label, [TAXONOMY[name] for name in GROUND_CLASSES])
    known = ~np.isin(label, [TAXONOMY[name] for name in UNSCORED]) & scene["core"]
    return {"counts": count_ground(ground["ground"], truth, valid=known)}


def ground_table(counts: Mapping[str, GroundCounts]) -> pd.DataFrame:
    """Return the scores of the ground filter per split."""
    sums = {split: np.sum([s["counts"] for s in scenes], axis=0) for split, scenes in group_by_split(counts).items()}
    return pd.DataFrame([{"split": split, **asdict(scores_of_counts(total))} for split, total in sums.items()])


def measure_supervoxels(scene: PointCloud, supervoxels: SupervoxelPartition) -> SupervoxelQuality:
    """Return the quality of the supervoxels of a scene over its core points.

    The boundary recall is estimated from a seeded sample of the points.
    """
    label = scene["label"]
    keep = scene["core"] & inliers(scene) & ~np.isin(label, [TAXONOMY[name] for name in UNSCORED])
    labels, truth = supervoxels["labels"][keep], label[keep].astype(np.int32)
    if len(truth) < 2:
        quality = np.full(len(SUPERVOXEL_SCORES), np.nan)
    else:
        scores = evaluate_partition(labels, truth, pairs=_near_pairs(scene.xyz[keep]))
        quality = np.array([getattr(scores, name) for name in SUPERVOXEL_SCORES], dtype=np.float64)
    return {"quality": quality, "weights": np.array([len(truth), len(np.unique(labels))])}


def _near_pairs(xyz: NDArray[np.floating], *, sample: int = 20_000, k: int = 10) -> NDArray[np.int64]:
    """Return pairs of sampled points and their nearest neighbours."""
    chosen = np.sort(np.random.default_rng(0).permutation(len(xyz))[:sample])
    neighbours = cKDTree(xyz).query(xyz[chosen], k=min(k, len(xyz) - 1) + 1)[1]
    first = np.repeat(chosen, neighbours.shape[1])
    pairs = np.column_stack([first, neighbours.ravel()])
    return pairs[pairs[:, 0] != pairs[:, 1]]


def supervoxel_table(measured: Mapping[str, SupervoxelQuality]) -> pd.DataFrame:
    """Return the scores of the supervoxels per split: means over scenes, weighted by their points."""
    rows = []
    for split, scenes in group_by_split(measured).items():
        quality, weights = np.array([s["quality"] for s in scenes]), np.array([s["weights"] for s in scenes])
        known = np.isfinite(quality)
        points = weights[:, :1] * known
        total = points.sum(axis=0)
        mean = np.where(total > 0, (np.where(known, quality, 0.0) * points).sum(axis=0) / np.maximum(total, 1), np.nan)
        counts = dict(zip(("n_points", "n_supervoxels"), weights.sum(axis=0).tolist(), strict=True))
        rows.append({"split": split, **dict(zip(SUPERVOXEL_SCORES, mean.tolist(), strict=True)), **counts})
    return pd.DataFrame(rows)
