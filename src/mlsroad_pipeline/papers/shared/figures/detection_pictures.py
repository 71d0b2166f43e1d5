"""Figure of the right, missed and false detections of some scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.shared.detection.outcomes import detection_outcomes
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters
from mlsroad_pipeline.papers.shared.detection.types import Detections, Segments
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, detection_pictures
from mlsroad_pipeline.reporting.clouds.view import oblique_view


def detection_figure(
    scenes: Sequence[PointCloud],
    objects: Sequence[Segments],
    detections: Sequence[Detections],
    *,
    scheme: ClassScheme,
    parameters: DetectionParameters,
    title: str,
) -> Figure:
    """Draw reference objects and detections of neighbouring scenes in oblique view."""
    origin = scenes[0].origin
    xyz = np.concatenate([scene.moved_to(origin).xyz[scene["core"]] for scene in scenes])
    results = [
        detection_outcomes(scene, own, made, scheme=scheme, parameters=parameters)
        for scene, own, made in zip(scenes, objects, detections, strict=True)
    ]
    truth, outcomes = (
        np.concatenate([values[k][scene["core"]] for scene, values in zip(scenes, results, strict=True)])
        for k in (0, 1)
    )
    names, view = tuple(parameters.classes), oblique_view(xyz)
    pictures = detection_pictures(xyz, view, classes=names, truth=truth, outcomes=outcomes)
    return cloud_figure(pictures, view, classes=names, present=truth, title=title)
