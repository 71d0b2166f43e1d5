"""Image-based labeller of Tomic et al. 2019, section 2.2: network training, and labels of the points in the images.

Importing this module imports torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.cityscapes import image_classes
from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.cameras.projection import project_points, sample_image
from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.labels import ImagePredictions
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.stages import inliers
from mlsroad_pipeline.papers.tomic2019.image_labels.crops import Sample
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_training import train_network
from mlsroad_pipeline.papers.tomic2019.image_labels.pspnet_weights import to_arrays
from mlsroad_pipeline.papers.tomic2019.image_labels.segmentation import MASKS, NETWORK, segmentation_of, segmenter_of
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.papers.tomic2019.image_labels.visibility import (
    DepthBuffer,
    HiddenPointRemoval,
    visibility_method,
    visible_points,
)

SLUG = "image_labels"

View = tuple[str, Camera, Callable[[], NDArray]]
"""Name of the camera, calibration and pose of an image, and a function that reads it: the picture (height, width, 3).
For a model of masks it returns the probabilities of the points' classes (height, width, classes)."""


def fit(
    samples: Sequence[Sample], *, parameters: ImageLabelsParameters, scheme: ClassScheme, cameras: Sequence[str],
    trained_on: Mapping[str, Any],
) -> tuple[ModelBundle, list[float]]:  # fmt: skip
    """Train the network."""
    network, losses = train_network(
        samples, n_classes=len(image_classes(scheme)), parameters=parameters.network, device=parameters.device
    )
    segmentation = {"source": NETWORK, "classes": Legend.of_scheme(scheme).to_json(), "name": "trained network"}
    made = make_model(
        to_arrays(network), segmentation, parameters=parameters, scheme=scheme, cameras=cameras,
        trained_on={**trained_on, "images": len(samples)},
    )  # fmt: skip
    return made, losses


def make_model(
    arrays: Mapping[str, NDArray], segmentation: Mapping[str, Any], *, parameters: ImageLabelsParameters,
    scheme: ClassScheme, cameras: Sequence[str], trained_on: Mapping[str, Any],
) -> ModelBundle:  # fmt: skip
    """Return a model whose images are segmented in a given way."""
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "cameras": list(cameras),
        "parameters": asdict(parameters),
        "segmentation": dict(segmentation),
        "attributes": [],
        "trained_on": dict(trained_on),
    }
    return ModelBundle(SLUG, arrays, metadata)


def label_scene(
    scene: PointCloud, around: Sequence[PointCloud], views: Iterable[View], bundle: ModelBundle
) -> ImagePredictions:
    """Label the points of a scene by the pixels that show them."""
    others = [part.moved_to(scene.origin).xyz[part["core"] & inliers(part)] for part in around]
    return label_points(scene, others, views, bundle, cameras=bundle.metadata["cameras"])


def label_points(
    scene: PointCloud, others: Sequence[NDArray[np.floating]], views: Iterable[View], bundle: ModelBundle, *,
    cameras: Sequence[str],
) -> ImagePredictions:  # fmt: skip
    """Label the points of a scene by the pixels that show them."""
    scheme, groups = bundle_scheme(bundle), list(cameras)
    keep = np.flatnonzero(inliers(scene))
    visibility = visibility_method(bundle.metadata["parameters"].get("visibility", "depth_buffer"))
    by_camera = label_through_images(
        np.concatenate([scene.xyz[keep], *others]), _segmented(views, bundle), groups=groups, n_classes=len(scheme),
        visibility=visibility, n_labelled=len(keep),
    )  # fmt: skip
    pooled = by_camera.pooled()
    seen = ~np.isnan(pooled[:, 0])
    out: ImagePredictions = {
        "label": np.full(len(scene), IGNORE, dtype=np.int16),
        "confidence": np.zeros(len(scene), dtype=np.float32),
        "seen": np.zeros(len(scene), dtype=np.bool_),
        "n_images": np.zeros((len(scene), len(groups)), dtype=np.int16),
        "probabilities": np.full((len(scene), len(groups), len(scheme)), np.nan, dtype=np.float16),
    }
    out["label"][keep[seen]] = pooled[seen].argmax(axis=1)
    out["confidence"][keep[seen]] = pooled[seen].max(axis=1)
    out["seen"][keep] = seen
    out["n_images"][keep] = by_camera.n_images.T
    out["probabilities"][keep] = by_camera.probabilities.transpose(1, 0, 2)
    return out


def _segmented(views: Iterable[View], bundle: ModelBundle) -> Iterator[SegmentedImage]:
    segment = None if segmentation_of(bundle)["source"] == MASKS else segmenter_of(bundle)
    for group, camera, read in views:
        yield group, camera, read if segment is None else partial(_read_and_segment, segment, read)


def _read_and_segment(
    segment: Callable[[NDArray[np.uint8]], NDArray[np.float32]], read: Callable[[], NDArray]
) -> NDArray[np.float32]:
    return segment(read())


Probabilities = NDArray[np.float32] | Callable[[], NDArray[np.float32]]

SegmentedImage = tuple[str, Camera, Probabilities]
"""Name of the camera, calibration and pose, and the class probabilities (height, width, c) of an image or a function
that computes them; it is called only if the image shows a point."""


class ImageLabels(NamedTuple):
    """Class probabilities of points from images, per camera of the survey."""

    # Mean class probabilities over the images of each camera; NaN where none of them shows the point
    probabilities: NDArray[np.float32]
    n_images: NDArray[np.int16]  # Number of images of each camera that show the point (redundancy)

    def pooled(self) -> NDArray[np.float32]:
        """Return the mean over the images of all cameras."""
        total = np.einsum("gnc,gn->nc", np.nan_to_num(self.probabilities), self.n_images.astype(np.float32))
        count = self.n_images.sum(axis=0, dtype=np.float32)[:, None]
        return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def label_through_images(
    xyz: ArrayLike, images: Iterable[SegmentedImage], *, groups: Sequence[str], n_classes: int,
    visibility: DepthBuffer | HiddenPointRemoval | None = None, max_distance: float = np.inf,
    n_labelled: int | None = None,
) -> ImageLabels:  # fmt: skip
    """Return the class probabilities of points from segmented images."""
    points = check_xyz(xyz)
    labelled = len(points) if n_labelled is None else n_labelled
    total = np.zeros((len(groups), labelled, n_classes), dtype=np.float32)
    count = np.zeros((len(groups), labelled), dtype=np.int16)
    for group, camera, probabilities in images:
        if group not in groups:
            raise DataError(f"an image is of camera {group!r}, the survey's cameras are {list(groups)}")
        if not project_points(points[:labelled], camera)[2].any():
            continue
        seen = visible_points(points, camera, method=visibility)[:labelled]
        if np.isfinite(max_distance):
            seen &= np.linalg.norm(points[:labelled] - camera.centre, axis=1) <= max_distance
        rows = np.flatnonzero(seen)
        if len(rows) == 0:
            continue
        table = probabilities() if callable(probabilities) else probabilities
        expected = (camera.height, camera.width, n_classes)
        if table.shape != expected:
            raise DataError(f"probabilities of an image must have shape {expected}, got {table.shape}")
        pixels, _, _ = project_points(points[rows], camera)
        k = list(groups).index(group)
        values = sample_image(table, pixels, np.ones(len(rows), dtype=np.bool_))
        known = ~np.isnan(values[:, 0])
        total[k, rows[known]] += values[known]
        count[k, rows[known]] += 1
    shown = count[:, :, None]
    mean = np.divide(total, shown, out=np.full_like(total, np.nan), where=shown > 0)
    return ImageLabels(mean, count)
