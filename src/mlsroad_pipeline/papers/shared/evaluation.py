"""Scores of labelled scenes, of labels through images, of the ground filter and of supervoxels, per split."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import IGNORE, TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.labels import PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey, group_by_split
from mlsroad_pipeline.algorithms.core.stage_results import GroundMask, SupervoxelPartition
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.metrics.ground import count_ground, scores_of_counts
from mlsroad_pipeline.algorithms.metrics.partition import evaluate_partition
from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores
from mlsroad_pipeline.algorithms.stages import inliers


def coarse_labels(label: NDArray[np.integer], trained: ClassScheme, scored: ClassScheme) -> NDArray[np.int16]:
    """Convert labels of the training scheme of a method to labels of the scoring scheme."""
    if trained == scored:
        return label.astype(np.int16)
    table = np.append(trained.coarsen(scored), np.int16(IGNORE))  # -1 indexes the last entry
    return table[label]


def count_scene(
    scene: PointCloud, labels: PointLabels, *, trained: ClassScheme, scored: ClassScheme
) -> dict[str, NDArray[np.int64]]:
    """Return the confusion matrix of the core points of a scene as `matrix`."""
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


def sum_by_split(
    matrices: Mapping[str, Mapping[str, NDArray[np.int64]]], name: str = "matrix"
) -> dict[str, NDArray[np.int64]]:
    """Return the sum of the confusion matrices of each split, those of a name."""
    total: dict[str, NDArray[np.int64]] = {}
    for key, counted in matrices.items():
        split = SceneKey.parse(key).split
        total[split] = total.get(split, 0) + counted[name]
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


LabelNames = Mapping[str, str]
"""Method to the name of its labels in the stored labels of a scene."""


def count_seen_scene(
    scene: PointCloud, labels: Mapping[str, NDArray], *, answers: LabelNames, trained: ClassScheme, scored: ClassScheme
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
        total = sum_by_split(counted, method)
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


GROUND_CLASSES = (
    "road", "lane_marking", "parking", "sidewalk", "curb", "manhole", "trail", "grass", "soil", "other_ground",
)  # fmt: skip
"""Taxonomy classes of ground points."""

UNSCORED = ("unlabelled", "outlier")

SUPERVOXEL_SCORES = ("boundary_recall", "under_segmentation_error", "accuracy_ceiling")


def count_ground_points(scene: PointCloud, ground: GroundMask) -> dict[str, NDArray[np.int64]]:
    """Count the core points of a scene by true and predicted ground, see `count_ground`."""
    label = scene["label"]
    truth = np.isin(label, [TAXONOMY[name] for name in GROUND_CLASSES])
    known = ~np.isin(label, [TAXONOMY[name] for name in UNSCORED]) & scene["core"]
    return {"counts": count_ground(ground["ground"], truth, valid=known)}


def ground_table(counts: Mapping[str, Mapping[str, NDArray[np.int64]]]) -> pd.DataFrame:
    """Return the scores of the ground filter per split."""
    sums = {split: np.sum([s["counts"] for s in scenes], axis=0) for split, scenes in group_by_split(counts).items()}
    return pd.DataFrame([{"split": split, **asdict(scores_of_counts(total))} for split, total in sums.items()])


def measure_supervoxels(scene: PointCloud, supervoxels: SupervoxelPartition) -> dict[str, NDArray]:
    """Return the quality of the supervoxels of a scene over its core points.

    `quality` has the scores of `SUPERVOXEL_SCORES`, NaN where undefined; `weights` the numbers of scored points and of
    supervoxels. The boundary recall is estimated from a seeded sample of the points.
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


def supervoxel_table(measured: Mapping[str, Mapping[str, NDArray]]) -> pd.DataFrame:
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
