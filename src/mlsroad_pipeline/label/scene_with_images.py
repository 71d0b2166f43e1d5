"""Labels and objects of one scene of a new survey, with the help of images."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.labels import ImagePredictions, PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.members import member
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud
from mlsroad_pipeline.algorithms.scenes.joining import join_pieces
from mlsroad_pipeline.algorithms.scenes.spans import SceneSpan
from mlsroad_pipeline.label.images import FUSION, IMAGE_LABELS
from mlsroad_pipeline.label.scene import LabelledScene, LabelSettings, label_new_scene
from mlsroad_pipeline.surveys.images import read_picture
from mlsroad_pipeline.surveys.masks import MaskLegend, read_mask

FEATURES = "detrended_forest"
"""Member of a fusion model that labels by features of the points."""

MAX_OCCLUDERS = 2_000_000
"""Largest number of points around a scene that are tested for occlusion; more points are thinned by a whole step."""


class CameraView(NamedTuple):
    """An image that may show a scene."""

    name: str
    group: str
    camera: Camera


class SceneViews(NamedTuple):
    """Images that may show a scene, and what their use needs."""

    views: tuple[CameraView, ...]
    cameras: tuple[str, ...]
    """Names of all cameras of the drive."""
    origin: NDArray[np.float64]
    """World coordinates that the camera poses are relative to, metres."""
    reach: int
    """Bins beyond the scene whose points may occlude it."""


class ImageLabeller:
    """Labeller of a model that uses images, for `label_cloud`."""

    def __init__(
        self,
        views: Sequence[tuple[str, Camera, Callable[[], NDArray]]],
        around: NDArray[np.floating],
        cameras: Sequence[str],
    ) -> None:
        self._views, self._around, self._cameras = views, around, cameras
        self.seen: NDArray[np.bool_] | None = None

    def __call__(self, cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.integer], NDArray[np.floating]]:
        """Return label and confidence of each point."""
        if bundle.slug != FUSION:
            by_images = self._label(cloud, bundle, self._cameras)
            return by_images["label"], by_images["confidence"]
        label, confidence = label_cloud(member(bundle, FEATURES), cloud)
        if self._cameras:
            by_images = self._label(cloud, member(bundle, IMAGE_LABELS), bundle.metadata["cameras"])
            by_features: PointLabels = {
                "label": label.astype(np.int16),
                "confidence": confidence.astype(np.float32),
            }
            fused = METHODS[FUSION].load("use")(by_features, by_images, bundle)
            label, confidence = fused["label"], fused["confidence"]
        return label, confidence

    def _label(self, cloud: PointCloud, bundle: ModelBundle, cameras: Sequence[str]) -> ImagePredictions:
        label_points = METHODS[IMAGE_LABELS].function(".labeller:label_points")
        by_images: ImagePredictions = label_points(cloud, [self._around], self._views, bundle, cameras=cameras)
        self.seen = by_images["seen"]
        return by_images


def _reader(model: ModelBundle) -> Callable[[str, Camera, str], NDArray]:
    """Return the function that reads a picture, or for a model of masks the class probabilities of its pixels."""
    network = member(model, IMAGE_LABELS)
    stored = network.metadata.get("segmentation", {})
    if stored.get("source") != "masks":
        return read_picture
    return partial(_read_mask, MaskLegend(Legend.from_json(stored["classes"]), bundle_scheme(network)))


def _read_mask(known: MaskLegend, path: str, camera: Camera, _: str) -> NDArray[np.float32]:
    return read_mask(path, camera, known)


def points_around(
    pieces: Sequence[Mapping[str, NDArray]], span: SceneSpan, reach: int, origin: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the points up to `reach` bins before and behind a scene that are not in its buffers."""
    before, behind = (span.first - reach, span.buffer_first), (span.buffer_stop, span.stop + reach)
    parts = [BinnedCloud.from_arrays(piece).between(*side) for piece in pieces for side in (before, behind)]
    step = -(-sum(map(len, parts)) // MAX_OCCLUDERS) or 1
    thinned = [part.cloud.xyz[::step] + (part.cloud.origin - origin) for part in parts if len(part)]
    return np.concatenate([np.zeros((0, 3)), *thinned]).astype(np.float32)


def label_pieces_with_images(
    pieces: Sequence[Mapping[str, NDArray]],
    around: Sequence[Mapping[str, NDArray]],
    pictures: Sequence[str],
    model: ModelBundle,
    *,
    images: SceneViews,
    span: SceneSpan,
    settings: LabelSettings,
    name: str,
    source: str,
) -> LabelledScene:
    """Join the pieces of a scene and label it with a model that uses images."""
    scene = join_pieces(pieces, span, settings.outliers, source)
    shift = scene.origin - images.origin
    read = _reader(model)
    views = [
        (view.group, view.camera.shifted(shift), partial(read, path, view.camera, view.name))
        for path, view in zip(pictures, images.views, strict=True)
    ]
    labeller = ImageLabeller(views, points_around(around, span, images.reach, scene.origin), images.cameras)
    labelled = label_new_scene(scene, model, settings, name=name, labeller=labeller)
    if labeller.seen is not None:
        labelled["counts"]["seen"] = np.array([(labeller.seen & scene["core"]).sum()])
    return labelled
