"""Outcome of a detector for each point of a scene, for pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.metrics.detection import match_detections
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps
from mlsroad_pipeline.papers.shared.detection.references import wanted_objects
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters
from mlsroad_pipeline.papers.shared.detection.types import Detections, Segments

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
        order, right = match_detections(
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
