"""What a detector found, missed and took for something else, in a picture of some scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detection.detector import Detections, Segments
from mlsroad_pipeline.algorithms.detection.references import wanted_objects
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters
from mlsroad_pipeline.algorithms.metrics.detection import match_detections
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, detection_pictures
from mlsroad_pipeline.reporting.clouds.view import oblique_view

RIGHT, MISSED, FALSE = 0, 1, 2


def detection_outcomes(
    scene: PointCloud,
    objects: Segments,
    detections: Detections,
    *,
    scheme: ClassScheme,
    parameters: DetectionParameters,
) -> tuple[NDArray[np.int16], NDArray[np.int8]]:
    """Tell of every point of a scene what a detector made of its object.

    Detections are matched as `detection.count_detections_of_scene` matches them.

    Raises
    ------
    MissingColumnError
        If the scene has no labels.
    """
    segments = objects["objects"]
    wanted_labels = parameters.labels_in(scheme)
    instances, classes = wanted_objects(scene, scheme, wanted_labels)
    overlaps = find_overlaps(instances, segments)
    kinds = classes[overlaps.instances]
    large = overlaps.instance_sizes >= parameters.min_points
    n_instances, n_segments = len(classes), int(segments.max(initial=-1)) + 1
    place = np.full(n_instances, IGNORE, dtype=np.int16)
    missed = np.zeros(n_instances, dtype=np.bool_)
    found = np.full(n_segments, IGNORE, dtype=np.int8)
    for k, wanted in enumerate(wanted_labels):
        of_class = kinds == wanted
        detected = np.where(detections["label"] == k, detections["score"], np.nan).astype(np.float64)
        order, right = match_detections(
            overlaps, detected[overlaps.segments], of_class, iou_threshold=parameters.iou_threshold
        )
        found[overlaps.segments[order]] = np.where(right, RIGHT, FALSE)
        close = (overlaps.iou >= parameters.iou_threshold) & np.isin(overlaps.segment, order[right])
        hit = np.isin(np.arange(len(kinds)), overlaps.instance[close & of_class[overlaps.instance]])
        place[overlaps.instances[of_class & (large | hit)]] = k
        missed[overlaps.instances[of_class & large & ~hit]] = True
    truth = np.where(instances > 0, place[instances], IGNORE).astype(np.int16)
    outcomes = np.where((instances > 0) & missed[instances], MISSED, IGNORE).astype(np.int8)
    of_segment = np.where(segments >= 0, found[segments], IGNORE) if n_segments else np.full(len(segments), IGNORE)
    return truth, np.where(of_segment != IGNORE, of_segment, outcomes).astype(np.int8)


def detection_figure(
    scenes: Sequence[PointCloud],
    objects: Sequence[Segments],
    detections: Sequence[Detections],
    *,
    scheme: ClassScheme,
    parameters: DetectionParameters,
    title: str,
) -> Figure:
    """Draw neighbouring scenes from the side: what is looked for, and what of it was found, missed or taken wrongly."""
    origin = scenes[0].origin
    xyz = np.concatenate([scene.moved_to(origin).xyz[scene["core"]] for scene in scenes])
    told = [
        detection_outcomes(scene, own, made, scheme=scheme, parameters=parameters)
        for scene, own, made in zip(scenes, objects, detections, strict=True)
    ]
    truth, outcomes = (
        np.concatenate([values[k][scene["core"]] for scene, values in zip(scenes, told, strict=True)]) for k in (0, 1)
    )
    names, view = tuple(parameters.classes), oblique_view(xyz)
    pictures = detection_pictures(xyz, view, classes=names, truth=truth, outcomes=outcomes)
    return cloud_figure(pictures, view, classes=names, present=truth, title=title)
