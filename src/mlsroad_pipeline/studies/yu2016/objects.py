"""What the workers of the study of Yu et al. 2016 do before any detector: segment a street, describe its objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.oriented_points import describe_surfaces
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detection.parts import describe_parts
from mlsroad_pipeline.algorithms.detection.references import wanted_objects
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters, object_classes
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps, score_segmentation
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stage import (
    SegmentationParameters,
    Segments,
    owned_by_core,
    segment_scene,
)
from mlsroad_pipeline.algorithms.visual_words.descriptions import describe_objects
from mlsroad_pipeline.studies.streets import timed

TOUCHING = 0.15
"""Objects closer than this touch, metres: the clustering distance of the paper."""

DESCRIPTIONS: Mapping[str, str] = {
    "hough_forest": "regions",
    "object_matching": "regions",
    "bottom_up_top_down": "surfaces",
    "visual_words": "groups",
}
"""Detector to that part of its parameters which says how objects are described."""

_DESCRIBE: Mapping[str, Any] = {"regions": describe_parts, "surfaces": describe_surfaces, "groups": describe_objects}


def segment_street(
    points: PointCloud, *, parameters: SegmentationParameters, scheme: ClassScheme, detection: DetectionParameters
) -> dict[str, Any]:
    """Segment a street and score the objects against the instances that it owns."""
    objects, seconds = timed(segment_scene, points, {"ground": points["ground"]}, parameters)
    found, least = objects["objects"], detection.min_points
    sought = detection.labels_in(scheme)
    instances, kinds = wanted_objects(points, scheme, sought)
    owned = owned_by_core(points, np.where(instances > 0, instances, -1), len(kinds))
    mine = np.where(owned[instances], instances, 0)
    figures = {name: np.array(value) for name, value in asdict(
        score_segmentation(mine, found, min_points=least)).items()}  # fmt: skip
    pairs = find_overlaps(mine, found)
    best = np.zeros(len(pairs.instances))
    np.maximum.at(best, pairs.instance, pairs.iou)
    large = pairs.instance_sizes >= least
    touching = touching_instances(points, instances, pairs.instances, least) & large
    weights = pairs.instance_sizes[touching]
    wanted = large & np.isin(kinds[pairs.instances], sought)
    extra = {
        "touching": best[touching].mean() if touching.any() else np.nan,
        "weighted_touching": best[touching] @ weights / weights.sum() if touching.any() else np.nan,
        "wanted": (best[wanted] >= detection.iou_threshold).mean() if wanted.any() else np.nan,
        "seconds": seconds,
    }
    scores = {**figures, **{name: np.array(value) for name, value in extra.items()}}
    classes = object_classes(points, objects, scheme=scheme, parameters=detection)
    return {"objects": objects, "classes": classes, "scores": scores}


def touching_instances(
    points: PointCloud, instances: NDArray[np.int32], names: NDArray[np.int64], min_points: int
) -> NDArray[np.bool_]:
    """Tell which instances share a Euclidean cluster with another one."""
    off = np.flatnonzero(~points["ground"])
    together = cluster(np.ascontiguousarray(points.xyz[off], dtype=np.float64), tolerance=TOUCHING)
    pairs = find_overlaps(instances[off], together)
    there = pairs.shared >= min_points
    crowded = np.bincount(pairs.segment[there], minlength=len(pairs.segments)) > 1
    return np.isin(names, pairs.instances[pairs.instance[there & crowded[pairs.segment]]])


def describe_street(points: PointCloud, objects: Segments, *, kind: str, parameters: Any) -> dict[str, Any]:
    """Describe the objects of a street as a detector does."""
    parts, seconds = timed(_DESCRIBE[kind], points, objects, parameters=parameters)
    return {"parts": parts, "facts": {"seconds": np.array(seconds)}}
