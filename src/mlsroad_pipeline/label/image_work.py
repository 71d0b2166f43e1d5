"""What workers of `label` do with a scene and its images; what few runs need is imported where it is used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.labels import ImagePredictions, PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.image_labels.camera import Camera
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, label_cloud
from mlsroad_pipeline.algorithms.models.members import member
from mlsroad_pipeline.algorithms.scenes.cutting import OutlierParameters, join_pieces
from mlsroad_pipeline.algorithms.scenes.tiling import PiecedCloud, SceneSpan
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.label.images import FUSION, IMAGE_LABELS
from mlsroad_pipeline.label.scene import label_new_scene
from mlsroad_pipeline.surveys.images import read_picture

FEATURES = "detrended_forest"

MOST_AROUND = 2_000_000
"""Points around a scene that may hide its own; of more, every second, third, ... is taken."""


class ThroughImages:
    """Labels the points of a scene with a model that looks at images, as `label_cloud` calls a labeller.

    Parameters
    ----------
    views : sequence of (str, Camera, callable)
        Camera's name, calibration and pose relative to the scene's origin, and what reads the picture.
    around : ndarray of shape (m, 3)
        Points that may hide the scene's, relative to its origin, metres.
    cameras : sequence of str
        Names of the survey's cameras.

    Attributes
    ----------
    seen : ndarray of shape (n,), bool, or None
        Which points of the scene that was labelled last are in an image; None before, and where there are no images.
    """

    def __init__(
        self, views: Sequence[tuple[str, Camera, Any]], around: NDArray[np.floating], cameras: Sequence[str]
    ) -> None:
        self._views, self._around, self._cameras = views, around, cameras
        self.seen: NDArray[np.bool_] | None = None

    def __call__(self, cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.integer], NDArray[np.floating]]:
        """Return a label and a confidence for every point."""
        if bundle.slug != FUSION:
            labels = self._images(cloud, bundle, self._cameras)
            return labels["label"], labels["confidence"]
        label, confidence = label_cloud(member(bundle, FEATURES), cloud)
        if self._cameras:
            from mlsroad_pipeline.algorithms.fusion.labeller import fuse_scene  # noqa: PLC0415  few runs need it

            images = self._images(cloud, member(bundle, IMAGE_LABELS), bundle.metadata["cameras"])
            single: PointLabels = {"label": label.astype(np.int16), "confidence": confidence.astype(np.float32)}
            fused = fuse_scene(single, images, bundle)
            label, confidence = fused["label"], fused["confidence"]
        return label, confidence

    def _images(self, cloud: PointCloud, bundle: ModelBundle, cameras: Sequence[str]) -> ImagePredictions:
        from mlsroad_pipeline.algorithms.image_labels.labeller import label_points  # noqa: PLC0415  it imports torch

        labels = label_points(cloud, [self._around], self._views, bundle, cameras=cameras)
        self.seen = labels["seen"]
        return labels


def points_around(
    pieces: Sequence[Mapping[str, NDArray]], span: SceneSpan, reach: int, origin: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Take the points before and behind a scene and its buffers."""
    before, behind = (span.first - reach, span.buffer_first), (span.buffer_stop, span.stop + reach)
    parts = [PiecedCloud.from_arrays(piece).between(*side) for piece in pieces for side in (before, behind)]
    every = -(-sum(map(len, parts)) // MOST_AROUND) or 1
    taken = [part.cloud.xyz[::every] + (part.cloud.origin - origin) for part in parts if len(part)]
    return np.concatenate([np.zeros((0, 3)), *taken]).astype(np.float32)


def label_pieces_through_images(
    pieces: Sequence[Mapping[str, NDArray]],
    around: Sequence[Mapping[str, NDArray]],
    pictures: Sequence[str],
    model: ModelBundle,
    *,
    views: Sequence[tuple[str, str, Camera]],
    cameras: Sequence[str],
    origin: NDArray[np.float64],
    reach: int,
    span: SceneSpan,
    outliers: OutlierParameters,
    codes: NDArray[np.uint8],
    rules: Mapping[str, ObjectRule],
    ground: GroundParameters,
    name: str,
    source: str,
) -> dict[str, Any]:
    """Assemble a scene of a new survey and label it with a model that looks at images."""
    scene = join_pieces(pieces, span, outliers, source)
    posed = [
        (group, camera.shifted(scene.origin - origin), partial(read_picture, path, camera, image))
        for path, (image, group, camera) in zip(pictures, views, strict=True)
    ]
    labeller = ThroughImages(posed, points_around(around, span, reach, scene.origin), cameras)
    found = label_new_scene(scene, model, codes=codes, rules=rules, ground=ground, name=name, labeller=labeller)
    if labeller.seen is not None:
        found["counts"]["seen"] = np.array([(labeller.seen & scene["core"]).sum()])
    return found
