"""Workers of the study of Yu et al. 2016: simulate and segment streets, describe objects, train and detect."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps, score_segmentation
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stage import (
    SegmentationParameters,
    Segments,
    owned_by_core,
    segment_scene,
)
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages, detect_objects
from mlsroad_pipeline.papers.shared.detection.regions import describe_parts
from mlsroad_pipeline.papers.shared.detection.scoring import (
    DetectionParameters,
    count_detections_of_scene,
    object_classes,
    wanted_objects,
)
from mlsroad_pipeline.papers.shared.detection.training import DetectorTraining
from mlsroad_pipeline.papers.shared.studies.streets import cut_street, timed
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.oriented_points import describe_surfaces
from mlsroad_pipeline.papers.yu2016.study.parameters import survey_of_run
from mlsroad_pipeline.papers.yu2016.visual_words.groups import describe_objects
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.runtime.survey import simulate_survey

TOUCHING = 0.15
"""Largest distance of touching objects, metres: the clustering distance of the paper."""

DESCRIPTIONS: Mapping[str, str] = {
    "hough_forest": "regions",
    "object_matching": "regions",
    "bottom_up_top_down": "surfaces",
    "visual_words": "groups",
    "visual_words_printed": "groups",
}
"""Detector to the field of its parameters with the description of objects."""

_DESCRIBE: Mapping[str, Any] = {"regions": describe_parts, "surfaces": describe_surfaces, "groups": describe_objects}


class SegmentationScores(TypedDict):
    """Scores of the segmentation of a street, as arrays without dimension; NaN where there is nothing to score.

    The fields of `InstanceScores` are stored too; those that tables use are named here.
    """

    # coverage, weighted_coverage: mean best IoU of the instances, and the same weighted by their points
    coverage: NDArray[np.floating]
    weighted_coverage: NDArray[np.floating]
    # touching, weighted_touching: the same over instances that share a Euclidean cluster with another one
    touching: NDArray[np.floating]
    weighted_touching: NDArray[np.floating]
    # precision, recall: share of segments, and of instances, that match one to one
    precision: NDArray[np.floating]
    recall: NDArray[np.floating]
    # share of instances of the classes to detect with an IoU of at least the threshold of detection
    wanted: NDArray[np.floating]
    seconds: NDArray[np.floating]  # CPU time


def segment_street(
    points: PointCloud, *, parameters: SegmentationParameters, scheme: ClassScheme, detection: DetectionParameters
) -> dict[str, Any]:
    """Segment a street: its objects, their classes, and the scores of the segmentation.

    Objects are scored against the instances that the street owns.
    """
    objects, seconds = timed(segment_scene, points, {"ground": points["ground"]}, parameters)
    segments, least = objects["objects"], detection.min_points
    sought = detection.labels_in(scheme)
    instances, kinds = wanted_objects(points, scheme, sought)
    owned = owned_by_core(points, np.where(instances > 0, instances, -1), len(kinds))
    mine = np.where(owned[instances], instances, 0)
    figures = {name: np.array(value) for name, value in asdict(
        score_segmentation(mine, segments, min_points=least)).items()}  # fmt: skip
    pairs = find_overlaps(mine, segments)
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
    scores = cast(SegmentationScores, {**figures, **{name: np.array(value) for name, value in extra.items()}})
    classes = object_classes(points, objects, scheme=scheme, parameters=detection)
    return {"objects": objects, "classes": classes, "scores": scores}


def touching_instances(
    points: PointCloud, instances: NDArray[np.int32], names: NDArray[np.int64], min_points: int
) -> NDArray[np.bool_]:
    """Return which instances share a Euclidean cluster with another one."""
    off = np.flatnonzero(~points["ground"])
    together = cluster(np.ascontiguousarray(points.xyz[off], dtype=np.float64), tolerance=TOUCHING)
    pairs = find_overlaps(instances[off], together)
    there = pairs.shared >= min_points
    crowded = np.bincount(pairs.segment[there], minlength=len(pairs.segments)) > 1
    return np.isin(names, pairs.instances[pairs.instance[there & crowded[pairs.segment]]])


def describe_street(points: PointCloud, objects: Segments, *, kind: str, parameters: Any) -> dict[str, Any]:
    """Describe the objects of a street for a detector; the facts have the CPU time."""
    parts, seconds = timed(_DESCRIBE[kind], points, objects, parameters=parameters)
    return {"parts": parts, "facts": {"seconds": np.array(seconds)}}


class StreetDetections(TypedDict):
    """Detections in a test street compared with its reference, see `count_detections_of_scene`."""

    n_objects: NDArray[np.integer]  # (classes,): reference objects of each class
    # label, right, score: (detections,): class, correctness and score of each detection
    label: NDArray[np.integer]
    right: NDArray[np.bool_]
    score: NDArray[np.floating]
    # curve_label, curve_right, curve_score: the same for all candidates of precision-recall curves
    curve_label: NDArray[np.integer]
    curve_right: NDArray[np.bool_]
    curve_score: NDArray[np.floating]
    seconds: NDArray[np.floating]  # CPU time of detection


def train_and_detect(
    train: Mapping[str, Mapping[str, Any]],
    test: Mapping[str, Mapping[str, Any]],
    *,
    method: str,
    parameters: Any,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    prevalence: Mapping[str, Mapping[str, float]],
    rare: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Train a detector and compare its detections in test streets with the reference.

    A training street has the `parts` and `classes` of its objects, a test street their `parts` and, as `scene`, handles
    of its points and objects. The result has the `StreetDetections` of each test street, and ``facts`` of the training.
    """
    weights = rare or {}
    labels: dict[str, dict[str, Any]] = {
        key: {**street["classes"], "weight": weights.get(key, 1.0)} for key, street in train.items()
    }
    usual = {key: classes for key, classes in labels.items() if key not in weights}
    known = replace(detection, prevalence=joint_prevalence(usual, prevalence, detection.classes))
    bundle, train_seconds = timed(
        METHODS[method].load("train"),
        {key: street["parts"] for key, street in train.items()}, labels,
        DetectorTraining(method, parameters, stages, known, scheme, {"streets": len(train)}),
    )  # fmt: skip
    own = np.concatenate([classes["label"][classes["own"]] for classes in labels.values()])
    variant = next(iter(bundle.metadata["learned"].values()))
    learned = variant["thresholds"]
    facts = {
        "train_seconds": np.array(train_seconds),
        "words": np.array(variant.get("words", 0)),
        "examples": np.bincount(own[own >= 0], minlength=len(detection.classes)),
        "thresholds": np.array([learned.get(name, np.inf) for name in detection.classes]),
    }
    results: dict[str, Any] = {"facts": facts}
    for key, street in test.items():
        detections, seconds = timed(detect_objects, street["parts"], bundle)
        points, objects = (handle.load() for handle in street["scene"])
        counts = count_detections_of_scene(points, objects, detections, scheme=scheme, parameters=detection)
        results[key] = {**counts, "seconds": np.array(seconds)}
    return results


def joint_prevalence(
    labels: Mapping[str, Mapping[str, NDArray]], prevalence: Mapping[str, Mapping[str, float]], classes: Sequence[str]
) -> dict[str, float]:
    """Return the prevalence factors of the joined surveys of one model."""
    expected, counted = np.zeros(len(classes)), np.zeros(len(classes))
    for street, objects in labels.items():
        own = prevalence[survey_of_run(street)]
        mine = objects["label"][objects["own"]]
        number = np.bincount(mine[mine >= 0], minlength=len(classes))
        counted += number
        expected += number * [float(own.get(name, 1.0)) for name in classes]
    return {name: float(e / n) for name, e, n in zip(classes, expected, counted, strict=True) if n > 0}


RUN_IN = 12.0
"""Road driven beyond both ends of a street, metres."""

IMAGE_GAP = 2.0
"""Smallest distance between two images of one moving object, metres."""

STREAK = 8.0
"""Greatest length of an image of a car in the reference, metres: 1.5 times the longest car."""

_CARS = [TAXONOMY[name] for name in ("car", "van")]
_MOVING = [
    TAXONOMY[name]
    for name in ("car", "van", "truck", "bus", "train", "other_vehicle", "motorcycle", "bicycle", "rider", "person")
]


def make_survey(*, simulation: SimulationParameters, ground: GroundParameters) -> dict[str, Any]:
    """Simulate a street as one scene; the facts have the CPU time of the ground filter and the number of streaks.

    The van drives `RUN_IN` farther at both ends. The scan planes are oblique, so that objects near the ends of a drive
    are scanned only in part; the scene does not own them.
    """
    columns = ("intensity", "gps_time", "scanner", "label", "instance")
    survey = simulate_survey(replace(simulation, length=simulation.length + 2 * RUN_IN), n_threads=1)
    street, station = cut_street(survey, ground=ground, columns=columns, source=f"street of seed {simulation.seed}")
    core = (station >= RUN_IN) & (station <= RUN_IN + simulation.length)
    images = separate_images(street.xyz, street["instance"], np.isin(street["label"], _MOVING))
    instance = without_streaks(street.xyz, images, np.isin(street["label"], _CARS))
    label = whole_gantries(street["label"], instance)
    cloud = replace(street, columns={**street.columns, "label": label, "instance": instance, "core": core})
    _, seconds = timed(find_ground, cloud, ground)
    streaks = len(np.unique(images[core & (images != instance)]))
    facts = {"seconds": seconds, "points": len(cloud), "streaks": streaks}
    return {"points": cloud, "facts": {name: np.array(value) for name, value in facts.items()}}


def separate_images(
    xyz: NDArray[np.floating], instance: NDArray[np.integer], rows: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Number the images of moving objects separately: each scanner records the whole object in another place.

    The two scanners pass a place about one second apart. In the point cloud, a moving car appears as two cars many
    metres apart, to annotators as to segmentations.
    """
    out = np.asarray(instance, dtype=np.int32).copy()
    last = int(out.max(initial=0))
    moving = np.flatnonzero(rows & (out > 0))
    if len(moving) == 0:
        return out
    moving = moving[np.argsort(out[moving], kind="stable")]
    names, first = np.unique(out[moving], return_index=True)
    flat = np.column_stack([xyz[moving, :2].astype(np.float64), np.zeros(len(moving))])
    for name, members in zip(names.tolist(), np.split(np.arange(len(moving)), first[1:]), strict=True):
        image = cluster(np.ascontiguousarray(flat[members]), tolerance=IMAGE_GAP)
        out[moving[members]] = np.where(image > 0, image + last, name)
        last += int(image.max())
    return out


def without_streaks(
    xyz: NDArray[np.floating], instance: NDArray[np.integer], rows: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Remove images of cars from the reference that are too long to be recognised.

    A car that moves with the van is scanned for as long as it stays next to it.
    """
    out = np.asarray(instance, dtype=np.int32).copy()
    cars = np.flatnonzero(rows & (out > 0))
    cars = cars[np.argsort(out[cars], kind="stable")]
    for members in np.split(cars, np.flatnonzero(np.diff(out[cars])) + 1):
        if len(members) < 2:
            continue
        flat = xyz[members, :2].astype(np.float64)
        axis = np.linalg.eigh(np.cov(flat.T))[1][:, -1]
        if np.ptp(flat @ axis) > STREAK:
            out[members] = 0
    return out


def whole_gantries(label: NDArray[np.integer], instance: NDArray[np.integer]) -> NDArray[np.int16]:
    """Assign the signs of a gantry to the class of the gantry, an object of 25 m across the road."""
    gantry = TAXONOMY["gantry"]
    numbers = np.unique(instance[label == gantry])
    return np.where(np.isin(instance, numbers[numbers > 0]), gantry, label).astype(np.int16)
