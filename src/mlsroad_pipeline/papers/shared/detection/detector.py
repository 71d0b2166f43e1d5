"""Detection of objects by trained models: choice of the variant, and labelling from raw coordinates."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.stage_results import GroundMask
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters, segment_scene
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.shared.detection.thresholds import detect_by_thresholds
from mlsroad_pipeline.papers.shared.detection.types import Description, Detections, ObjectLabels, Segments

WITH_INTENSITY, GEOMETRY = "geometry+intensity", "geometry"
"""Variants of a model: trained with intensity, and without for surveys that have none."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class DetectionStages:
    """Parameters of the stages before detection, stored in the model and applied to new surveys."""

    ground: GroundParameters  # The ground filter
    segmentation: SegmentationParameters  # The segmentation into objects


def trained_detector(parts: Description, bundle: ModelBundle) -> Any:
    """Rebuild the variant of a model that fits a scene: a detector with the `score` of each object for each class.

    Its `thresholds` are the lowest score of each class at which an object is detected; a score of 0 is no similarity.
    """
    variants = bundle.metadata["variants"]
    variant = WITH_INTENSITY if bool(parts["intensity"]) and WITH_INTENSITY in variants else GEOMETRY
    if variant not in variants:
        raise DataError(
            f"model {bundle.slug!r} was trained with intensity alone (without_intensity: false), and the scene has none"
        )
    kind = METHODS[bundle.slug].load("use")
    return kind.from_arrays(arrays_under(bundle.arrays, f"{variant}."), intensity=variant == WITH_INTENSITY)


def detect_objects(parts: Description, bundle: ModelBundle) -> Detections:
    """Detect the described objects of a scene by the method of the model."""
    trained = trained_detector(parts, bundle)
    scores = trained.score(parts)
    label, score = detect_by_thresholds(scores, trained.thresholds)
    return {"label": label, "score": score, "scores": scores.astype(np.float32)}


def label_detected_objects(
    cloud: PointCloud, bundle: ModelBundle, detect: Callable[[Segments], ObjectLabels]
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Label the points of detected objects, starting from raw coordinates."""
    labels, confidence = np.full(len(cloud), IGNORE, dtype=np.int16), np.zeros(len(cloud), dtype=np.float32)
    if len(cloud) == 0:
        return labels, confidence
    stored: Mapping[str, Any] = bundle.metadata["parameters"]
    if "intensity" in bundle.metadata["attributes"] and "intensity" not in cloud:
        level = logging.INFO if "core" in cloud else logging.WARNING  # for scenes of a survey, the survey is warned of
        logger.log(level, "%s has no intensity: objects are detected by their shape alone", cloud.source)
    ground: GroundMask
    if "ground" in cloud:
        ground = {"ground": cloud["ground"]}
    else:
        ground = find_ground(cloud, GroundParameters(**stored["ground"]))
    objects = segment_scene(cloud, ground, SegmentationParameters(**stored["segmentation"]))
    detected = detect(objects)
    wanted = np.array(bundle.metadata["wanted"], dtype=np.int16)
    if len(detected["label"]) and detected["label"].max() >= len(wanted):
        raise DataError(f"model {bundle.slug!r} detects class {detected['label'].max()} of {len(wanted)}")
    inside = objects["objects"] >= 0
    label = np.where(detected["label"] >= 0, wanted[detected["label"]], IGNORE).astype(np.int16)
    labels[inside] = label[objects["objects"][inside]]
    confidence[inside] = detected["score"][objects["objects"][inside]]
    return labels, confidence


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Segment a point cloud, describe its objects by the method of the model and label the points of detected ones.

    Intensity is used where the cloud and the model have it.
    """
    method = METHODS[bundle.slug]
    parameters = method.load("parameters")(**bundle.metadata["parameters"][bundle.slug])

    def detect(objects: Segments) -> ObjectLabels:
        described = method.load("describe")(cloud, objects, parameters=getattr(parameters, method.description))
        return detect_objects(described, bundle)

    return label_detected_objects(cloud, bundle, detect)
