"""What the workers of the study of Yu et al. 2016 do: segment a street, describe objects, train and detect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines import bottom_up_top_down, hough_forest, object_matching
from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down_training import train_bottom_up_top_down
from mlsroad_pipeline.algorithms.baselines.hough_forest_training import train_hough_forest
from mlsroad_pipeline.algorithms.baselines.object_matching_training import train_object_matching
from mlsroad_pipeline.algorithms.baselines.object_parts import describe_parts
from mlsroad_pipeline.algorithms.baselines.oriented_points import describe_surfaces
from mlsroad_pipeline.algorithms.classes import ClassScheme
from mlsroad_pipeline.algorithms.detection import DetectionParameters, count_detections_of_scene, object_classes
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps, score_segmentation
from mlsroad_pipeline.algorithms.object_detectors import DetectionStages
from mlsroad_pipeline.algorithms.object_segmentation import SegmentationParameters, owned_by_core, segment_scene
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.studies.streets import timed
from mlsroad_pipeline.algorithms.visual_words import labeller
from mlsroad_pipeline.algorithms.visual_words.training import train_detector

TOUCHING = 0.15
"""Objects closer than this touch, metres: the clustering distance of the paper."""

_DESCRIBE: Mapping[str, Any] = {
    "hough_forest": (describe_parts, "regions"),
    "object_matching": (describe_parts, "regions"),
    "bottom_up_top_down": (describe_surfaces, "surfaces"),
    "visual_words": (labeller.describe_objects, "groups"),
}
_TRAIN: Mapping[str, Any] = {
    "hough_forest": train_hough_forest,
    "object_matching": train_object_matching,
    "bottom_up_top_down": train_bottom_up_top_down,
    "visual_words": train_detector,
}
_DETECT: Mapping[str, Any] = {
    module.SLUG: module.detect_scene for module in (labeller, hough_forest, object_matching, bottom_up_top_down)
}


def segment_street(
    points: PointCloud, *, parameters: SegmentationParameters, scheme: ClassScheme, detection: DetectionParameters
) -> dict[str, Any]:
    """Segment a street and score the objects against the instances that it owns.

    Parameters
    ----------
    points : PointCloud
        What `make_survey` gave.
    parameters : SegmentationParameters
        The method and its parameters.
    scheme : ClassScheme
        The classes.
    detection : DetectionParameters
        The wanted classes, and the smallest reference object.

    Returns
    -------
    dict
        ``objects``, what `segment_scene` gave; ``classes``, what `object_classes` gave for them; ``scores``: figures of
        `score_segmentation`, ``touching`` and ``weighted_touching``: coverage of the instances that touch another,
        ``wanted``: share of the instances of the wanted classes that are found with an IoU of
        `detection.iou_threshold`, ``seconds``.
    """
    objects, seconds = timed(segment_scene, points, {"ground": points["ground"]}, parameters)
    found, least = objects["objects"], detection.min_points
    owned = owned_by_core(
        points, np.where(points["instance"] > 0, points["instance"], -1), int(points["instance"].max()) + 1
    )
    mine = np.where(owned[points["instance"]], points["instance"], 0)
    figures = {name: np.array(value) for name, value in asdict(
        score_segmentation(mine, found, min_points=least)).items()}  # fmt: skip
    pairs = find_overlaps(mine, found)
    best = np.zeros(len(pairs.instances))
    np.maximum.at(best, pairs.instance, pairs.iou)
    large = pairs.instance_sizes >= least
    touching = touching_instances(points, pairs.instances, least) & large
    weights = pairs.instance_sizes[touching]
    first = np.unique(mine, return_index=True)
    label = scheme.encode(points["label"], source=points.source)[first[1][np.searchsorted(first[0], pairs.instances)]]
    wanted = large & np.isin(label, detection.labels_in(scheme))
    extra = {
        "touching": best[touching].mean() if touching.any() else np.nan,
        "weighted_touching": best[touching] @ weights / weights.sum() if touching.any() else np.nan,
        "wanted": (best[wanted] >= detection.iou_threshold).mean() if wanted.any() else np.nan,
        "seconds": seconds,
    }
    scores = {**figures, **{name: np.array(value) for name, value in extra.items()}}
    classes = object_classes(points, objects, scheme=scheme, parameters=detection)
    return {"objects": objects, "classes": classes, "scores": scores}


def touching_instances(points: PointCloud, names: NDArray[np.int64], min_points: int) -> NDArray[np.bool_]:
    """Tell which instances share a Euclidean cluster with another one.

    Parameters
    ----------
    points : PointCloud
        A street with `ground` and `instance`.
    names : ndarray of int64
        The instances.
    min_points : int
        Points that an instance must have in a cluster to count in it.

    Returns
    -------
    ndarray of bool
        One flag per instance.
    """
    off = np.flatnonzero(~points["ground"])
    together = cluster(np.ascontiguousarray(points.xyz[off], dtype=np.float64), tolerance=TOUCHING)
    pairs = find_overlaps(points["instance"][off], together)
    there = pairs.shared >= min_points
    crowded = np.bincount(pairs.segment[there], minlength=len(pairs.segments)) > 1
    return np.isin(names, pairs.instances[pairs.instance[there & crowded[pairs.segment]]])


def describe_street(
    points: PointCloud, objects: Mapping[str, NDArray], *, method: str, parameters: Any
) -> dict[str, Any]:
    """Describe the objects of a street as a detector does.

    Parameters
    ----------
    points : PointCloud
        What `make_survey` gave.
    objects : mapping
        What `segment_scene` gave.
    method : str
        The detector.
    parameters : dataclass
        Its parameters.

    Returns
    -------
    dict
        ``parts``, and ``facts`` with the ``seconds``.
    """
    describe, described_by = _DESCRIBE[method]
    parts, seconds = timed(describe, points, objects, parameters=getattr(parameters, described_by))
    return {"parts": parts, "facts": {"seconds": np.array(seconds)}}


def train_and_detect(
    train: Mapping[str, Mapping[str, Any]],
    test: Mapping[str, Mapping[str, Any]],
    *,
    method: str,
    parameters: Any,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
) -> dict[str, dict[str, NDArray]]:
    """Train a detector on streets and compare its detections in others with what is there.

    Parameters
    ----------
    train : mapping of str to mapping
        Street to the ``classes`` of its objects, see `segment_street`, and their ``parts``.
    test : mapping of str to mapping
        Street to its ``points``, ``objects`` and ``parts``.
    method : str
        The detector.
    parameters : dataclass
        Its parameters.
    stages : DetectionStages
        How the streets were prepared.
    detection : DetectionParameters
        The wanted classes.
    scheme : ClassScheme
        The classes.

    Returns
    -------
    dict
        Test street to what `count_detections_of_scene` gave, with the ``seconds`` of the detection; ``facts``:
        ``train_seconds``, ``examples`` (training objects of each class) and ``thresholds``.
    """
    judge: dict[str, Any] = {"scheme": scheme, "parameters": detection}
    labels = {key: given["classes"] for key, given in train.items()}
    bundle, train_seconds = timed(
        _TRAIN[method],
        {key: given["parts"] for key, given in train.items()}, labels, parameters=parameters, stages=stages,
        detection=detection, scheme=scheme, trained_on={"streets": len(train)},
    )  # fmt: skip
    own = np.concatenate([found["label"][found["own"]] for found in labels.values()])
    learned = next(iter(bundle.metadata["learned"].values()))["thresholds"]
    facts = {
        "train_seconds": np.array(train_seconds),
        "examples": np.bincount(own[own >= 0], minlength=len(detection.classes)),
        "thresholds": np.array([learned.get(name, np.inf) for name in detection.classes]),
    }
    results = {"facts": facts}
    for key, given in test.items():
        found, seconds = timed(_DETECT[method], given["parts"], bundle)
        counts = count_detections_of_scene(given["points"], given["objects"], found, **judge)
        results[key] = {**counts, "seconds": np.array(seconds)}
    return results
