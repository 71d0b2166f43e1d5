"""Reference classes of objects, outcomes of detections, and their scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NotRequired, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import group_by_split
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.metrics import detection
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps
from mlsroad_pipeline.algorithms.segmentation.stage import owned_by_core, reference_objects
from mlsroad_pipeline.papers.shared.detection.types import Detections, Segments


def wanted_objects(
    scene: PointCloud, scheme: ClassScheme, wanted: NDArray[np.int16]
) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return the reference objects of a scene, with instances of several wanted classes split by class.

    A sign on a lamp may belong to the instance of the lamp while its points are labelled as a sign. The points of each
    further wanted class are then an object.
    """
    instances, classes = reference_objects(scene, scheme)
    labels = scheme.encode(scene["label"], source=scene.source)
    aside = np.flatnonzero((instances > 0) & (labels != classes[instances]) & np.isin(labels, wanted))
    pairs, numbers = np.unique(instances[aside].astype(np.int64) * len(scheme) + labels[aside], return_inverse=True)
    split = instances.copy()
    split[aside] = numbers + len(classes)
    return split, np.append(classes, (pairs % len(scheme)).astype(np.int16))


def without_reference(
    scene: PointCloud, segments: NDArray[np.integer], n_segments: int, *, scheme: ClassScheme, wanted: NDArray[np.int16]
) -> NDArray[np.bool_]:
    """Return which segments have no reference information and are excluded from training and scores."""
    labels = scheme.encode(scene["label"], source=scene.source)
    unknown = labels == IGNORE
    if "instance" in scene:
        unknown |= (scene["instance"] == 0) & np.isin(labels, wanted)
    inside = segments >= 0
    counts = np.bincount(segments[inside], minlength=n_segments)
    return np.asarray(2 * np.bincount(segments[inside & unknown], minlength=n_segments) > counts)


RIGHT, MISSED, FALSE = 0, 1, 2
"""Outcomes of points: in a matched detection, in a missed object, in a false detection."""


def detection_outcomes(
    scene: PointCloud,
    objects: Segments,
    detections: Detections,
    *,
    scheme: ClassScheme,
    parameters: DetectionParameters,
) -> tuple[NDArray[np.int16], NDArray[np.int8]]:
    """Return the reference class and the outcome of the detection of each point of a scene.

    Detections are matched as in `scoring.count_detections_of_scene`.
    """
    segments = objects["objects"]
    wanted_labels = parameters.labels_in(scheme)
    instances, classes = wanted_objects(scene, scheme, wanted_labels)
    overlaps = find_overlaps(instances, segments)
    kinds = classes[overlaps.instances]
    large = overlaps.instance_sizes >= parameters.min_points
    n_instances, n_segments = len(classes), int(segments.max(initial=-1)) + 1
    target = np.full(n_instances, IGNORE, dtype=np.int16)
    missed = np.zeros(n_instances, dtype=np.bool_)
    outcome = np.full(n_segments, IGNORE, dtype=np.int8)
    for k, label in enumerate(wanted_labels):
        of_class = kinds == label
        detected = np.where(detections["label"] == k, detections["score"], np.nan).astype(np.float64)
        order, right = detection.match_detections(
            overlaps, detected[overlaps.segments], of_class, iou_threshold=parameters.iou_threshold
        )
        outcome[overlaps.segments[order]] = np.where(right, RIGHT, FALSE)
        close = (overlaps.iou >= parameters.iou_threshold) & np.isin(overlaps.segment, order[right])
        hit = np.isin(np.arange(len(kinds)), overlaps.instance[close & of_class[overlaps.instance]])
        target[overlaps.instances[of_class & (large | hit)]] = k
        missed[overlaps.instances[of_class & large & ~hit]] = True
    truth = np.where(instances > 0, target[instances], IGNORE).astype(np.int16)
    outcomes = np.where((instances > 0) & missed[instances], MISSED, IGNORE).astype(np.int8)
    of_segment = np.where(segments >= 0, outcome[segments], IGNORE) if n_segments else np.full(len(segments), IGNORE)
    return truth, np.where(of_segment != IGNORE, of_segment, outcomes).astype(np.int8)


_COUNTED = ("label", "score", "right", "object", "curve_label", "curve_score", "curve_right")


class ObjectClasses(TypedDict):
    """Reference classes of the objects of a training scene, as `object_classes` returns them."""

    label: NDArray[np.int16]  # Index in `DetectionParameters.classes`; -1 for objects that match no wanted class
    own: NDArray[np.bool_]  # Whether the scene's core owns the object and a detector may be trained on it
    # Weight of all objects of the scene, 0 or more. Objects of weight 0 are trained on, and are excluded from threshold
    # selection: for scenes in which easily confused objects are far more frequent than in the target survey.
    weight: NotRequired[float]


@dataclass(frozen=True)
class DetectionParameters:
    """Wanted classes and criterion of a true positive."""

    scheme: str = "yu2016"  # Class scheme
    classes: Sequence[str] = ("light pole", "traffic sign", "car")  # The classes to detect
    # A detection is a true positive when its points overlap a still unmatched reference object of its class with at
    # least this IoU
    iou_threshold: float = 0.5
    min_points: int = 30  # Reference objects with fewer points are excluded
    # Ratio of the frequency of a class in the target survey to that in the training scenes; 1 for other classes. Rare
    # objects are over-represented in training scenes, and thresholds chosen there give too many false positives where
    # these objects are rarer. Smaller values raise the threshold.
    prevalence: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.classes:
            raise ParameterError("detection.classes must name at least one class")
        if not 0 < self.iou_threshold < 1:
            raise ParameterError(f"detection.iou_threshold must be between 0 and 1, got {self.iou_threshold!r}")
        check_positive(self.min_points, "detection.min_points")
        for name, factor in self.prevalence.items():
            if name not in self.classes:
                raise ParameterError(
                    f"detection.prevalence names {name!r}, which is not looked for (classes: {', '.join(self.classes)})"
                )
            check_positive(factor, f"detection.prevalence of {name!r}")

    @property
    def factors(self) -> NDArray[np.float64]:
        """Prevalence of each class, (c,)."""
        return np.array([float(self.prevalence.get(name, 1.0)) for name in self.classes])

    def labels_in(self, scheme: ClassScheme) -> NDArray[np.int16]:
        """Return the labels of the wanted classes."""
        unknown = [name for name in self.classes if name not in scheme.classes]
        if unknown:
            raise ParameterError(
                f"detection.classes: scheme {scheme.name!r} has no {', '.join(unknown)} (classes: "
                f"{', '.join(scheme.classes)})"
            )
        return np.array([scheme.classes.index(name) for name in self.classes], dtype=np.int16)


def object_classes(
    scene: PointCloud, objects: Segments, *, scheme: ClassScheme, parameters: DetectionParameters
) -> ObjectClasses:
    """Return the class of the reference object that each object of a training scene matches.

    An object is excluded from training where it matches a reference object of a wanted class with fewer than
    `parameters.min_points`, or lies where the reference has no information (`without_reference`).
    """
    segments = objects["objects"]
    n = int(segments.max(initial=-1)) + 1
    wanted = parameters.labels_in(scheme)
    instances, classes = wanted_objects(scene, scheme, wanted)
    overlaps = find_overlaps(instances, segments)
    place = np.full(len(scheme), IGNORE, dtype=np.int16)
    place[wanted] = np.arange(len(wanted))
    label = np.full(n, IGNORE, dtype=np.int16)
    good = np.flatnonzero(overlaps.iou >= parameters.iou_threshold)
    good = good[np.argsort(overlaps.iou[good], kind="stable")]  # the best overlap is written last
    matched = classes[overlaps.instances[overlaps.instance[good]]]
    label[overlaps.segments[overlaps.segment[good]]] = np.where(matched == IGNORE, IGNORE, place[matched])
    own = owned_by_core(scene, segments, n)
    small = np.zeros(n, dtype=np.bool_)
    small[overlaps.segments[overlaps.segment[good]]] = (
        overlaps.instance_sizes[overlaps.instance[good]] < parameters.min_points
    )
    own &= ~without_reference(scene, segments, n, scheme=scheme, wanted=wanted)
    return {"label": label, "own": own & ~(small & (label != IGNORE))}


def count_detections_of_scene(
    scene: PointCloud,
    objects: Segments,
    detections: Detections,
    *,
    scheme: ClassScheme,
    parameters: DetectionParameters,
) -> dict[str, NDArray]:
    """Match the detections of a scene with its reference objects; each object counts in the scene that owns it.

    Detections where the reference has no information (`without_reference`) are excluded.
    """
    segments = objects["objects"]
    n = int(segments.max(initial=-1)) + 1
    labels, every = detections["label"], detections["scores"]
    if len(labels) != n:
        raise DataError(f"{scene.source}: {len(labels)} detections for {n} objects")
    if every.shape != (n, len(parameters.classes)):
        raise DataError(
            f"{scene.source}: scores {every.shape} for {n} objects and {len(parameters.classes)} wanted classes"
        )
    sought = parameters.labels_in(scheme)
    instances, classes = wanted_objects(scene, scheme, sought)
    overlaps = find_overlaps(instances, segments)
    own_segment = owned_by_core(scene, segments, n)
    own_segment &= ~without_reference(scene, segments, n, scheme=scheme, wanted=sought)
    own_instance = owned_by_core(scene, np.where(instances > 0, instances, -1), len(classes))
    kinds = classes[overlaps.instances]
    large = overlaps.instance_sizes >= parameters.min_points
    known: dict[str, list[NDArray]] = {name: [] for name in _COUNTED}
    counts: list[int] = []
    for label, wanted in enumerate(sought):
        detected = np.where(labels == label, detections["score"], np.nan)
        scored = np.where(every[:, label] > 0, every[:, label], np.nan)
        for prefix, values in (("", detected), ("curve_", scored)):
            score = values[overlaps.segments].astype(np.float64)
            order, right = detection.match_detections(
                overlaps, score, kinds == wanted, iou_threshold=parameters.iou_threshold
            )
            mine = own_segment[overlaps.segments[order]]
            known[f"{prefix}label"].append(np.full(int(mine.sum()), label, dtype=np.int16))
            known[f"{prefix}score"].append(score[order][mine].astype(np.float32))
            known[f"{prefix}right"].append(right[mine])
            if not prefix:
                known["object"].append(overlaps.segments[order][mine])
        counts.append(int(((kinds == wanted) & large & own_instance[overlaps.instances]).sum()))
    return {"n_objects": np.array(counts), **{name: np.concatenate(parts) for name, parts in known.items()}}


def detection_table(
    counted: Mapping[str, Mapping[str, NDArray]], *, method: str, classes: Sequence[str]
) -> pd.DataFrame:
    """Return precision, recall and F-score of each split."""
    tables = []
    for split, scenes in group_by_split(counted).items():
        label, right, n_objects, _ = _joined(scenes)
        counts: list[detection.DetectionCounts] = []
        for k in range(len(classes)):
            flags = right[label == k]
            counts.append(detection.count_detections(flags, max(int(n_objects[k]), int(flags.sum()))))
        tables.append(detection.detection_scores(counts, method=method, split=split, classes=classes))
    return pd.concat(tables, ignore_index=True)


def detection_curves(
    counted: Mapping[str, Mapping[str, NDArray]], *, split: str, classes: Sequence[str]
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
    """Return precision and recall of each class at all thresholds on its score, over the scenes of a split."""
    label, right, n_objects, score = _joined(group_by_split(counted)[split], "curve_")
    curves = {}
    for k, name in enumerate(classes):
        flags = right[label == k]
        total = max(int(n_objects[k]), int(flags.sum()))
        if total:
            curves[name] = detection.precision_recall_curve(score[label == k], flags, total)
    return curves


def _joined(
    counted: Sequence[Mapping[str, NDArray]], prefix: str = ""
) -> tuple[NDArray[np.int16], NDArray[np.bool_], NDArray[np.int64], NDArray[np.float32]]:
    names = [f"{prefix}{name}" for name in ("label", "right", "score")]
    label, right, score = (np.concatenate([scene[name] for scene in counted]) for name in names)
    return label, right, np.sum([scene["n_objects"] for scene in counted], axis=0), score
