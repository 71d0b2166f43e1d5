"""The labeller of Tomic et al. 2019, section 2.2: a trained network, and classes for the points that its images show.

Importing this module imports torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.image_labels.camera import Camera
from mlsroad_pipeline.algorithms.image_labels.cityscapes import image_classes, point_probabilities
from mlsroad_pipeline.algorithms.image_labels.crops import Sample
from mlsroad_pipeline.algorithms.image_labels.labelling import SegmentedImage, label_through_images
from mlsroad_pipeline.algorithms.image_labels.pspnet import PSPNet
from mlsroad_pipeline.algorithms.image_labels.pspnet_training import train_network
from mlsroad_pipeline.algorithms.image_labels.pspnet_weights import from_arrays, to_arrays
from mlsroad_pipeline.algorithms.image_labels.segmentation import segment_image
from mlsroad_pipeline.algorithms.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.stages import inliers

SLUG = "image_labels"

View = tuple[str, Camera, Callable[[], NDArray[np.uint8]]]
"""Which of the survey's cameras took an image, its calibration and pose, and what reads the picture."""


def fit(
    samples: Sequence[Sample], *, parameters: ImageLabelsParameters, scheme: ClassScheme, cameras: Sequence[str],
    trained_on: Mapping[str, Any],
) -> tuple[ModelBundle, list[float]]:  # fmt: skip
    """Train the network.

    Parameters
    ----------
    samples : sequence of (ndarray, ndarray)
        Images, and their labels as `encode_label_image` gives them.
    parameters : ImageLabelsParameters
        How.
    scheme : ClassScheme
        The classes of points.
    cameras : sequence of str
        Names of the survey's cameras.
    trained_on : mapping
        What the model's metadata say of the training data; JSON values.

    Returns
    -------
    bundle : ModelBundle
        The model, for the registry.
    losses : list of float
        Loss of every step.

    Raises
    ------
    DataError
        If there are no images, or an image and its labels do not fit.
    """
    network, losses = train_network(samples, n_classes=len(image_classes(scheme)), parameters=parameters.network)
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "cameras": list(cameras),
        "parameters": asdict(parameters),
        "attributes": [],
        "trained_on": {**trained_on, "images": len(samples)},
    }
    return ModelBundle(SLUG, to_arrays(network), metadata), losses


def network_of(bundle: ModelBundle) -> PSPNet:
    """Return the network of a model.

    Parameters
    ----------
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    PSPNet
        The network, ready to predict.

    Raises
    ------
    DataError
        If the arrays are not those of the network.
    """
    backbone = bundle.metadata["parameters"]["network"]["backbone"]
    return from_arrays(bundle.arrays, n_classes=len(bundle.classes) + 1, backbone=backbone)


def label_scene(
    scene: PointCloud, around: Sequence[PointCloud], views: Iterable[View], bundle: ModelBundle
) -> dict[str, NDArray]:
    """Give the points of a scene the classes of the pixels that show them.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    around : sequence of PointCloud
        The scenes beside it, whose points may hide those of the scene.
    views : iterable of (str, Camera, callable)
        Images that may show the scene, their poses relative to the scene's origin.
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    dict of str to ndarray
        ``label`` int16 (n,), the most probable class over all images, -1 where no image sees the point; ``confidence``
        float32 (n,), its probability, 0 there; ``seen`` bool (n,); ``n_images`` int16 (n, groups) and
        ``probabilities`` float16 (n, groups, classes) of each camera, NaN where it does not see the point.

    Raises
    ------
    DataError
        If an image is of a camera that the model does not name.
    """
    others = [part.moved_to(scene.origin).xyz[part["core"] & inliers(part)] for part in around]
    return label_points(scene, others, views, bundle, cameras=bundle.metadata["cameras"])


def label_points(
    scene: PointCloud, others: Sequence[NDArray[np.floating]], views: Iterable[View], bundle: ModelBundle, *,
    cameras: Sequence[str],
) -> dict[str, NDArray]:  # fmt: skip
    """Give the points of a scene the classes of the pixels that show them.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    others : sequence of ndarray of shape (m, 3)
        Points around it that may hide its own, relative to its origin, metres.
    views : iterable of (str, Camera, callable)
        Images that may show the scene, their poses relative to the scene's origin. Those that show none of its points
        are not read.
    bundle : ModelBundle
        A model of `fit`.
    cameras : sequence of str
        Names of the survey's cameras.

    Returns
    -------
    dict of str to ndarray
        As `label_scene`.

    Raises
    ------
    DataError
        If an image is of a camera that is not named.
    """
    scheme, groups = bundle_scheme(bundle), list(cameras)
    keep = np.flatnonzero(inliers(scene))
    found = label_through_images(
        np.concatenate([scene.xyz[keep], *others]), _segmented(views, bundle, scheme), groups=groups,
        n_classes=len(scheme), n_labelled=len(keep),
    )  # fmt: skip
    pooled = found.pooled()
    seen = ~np.isnan(pooled[:, 0])
    out: dict[str, NDArray] = {
        "label": np.full(len(scene), IGNORE, dtype=np.int16),
        "confidence": np.zeros(len(scene), dtype=np.float32),
        "seen": np.zeros(len(scene), dtype=np.bool_),
        "n_images": np.zeros((len(scene), len(groups)), dtype=np.int16),
        "probabilities": np.full((len(scene), len(groups), len(scheme)), np.nan, dtype=np.float16),
    }
    out["label"][keep[seen]] = pooled[seen].argmax(axis=1)
    out["confidence"][keep[seen]] = pooled[seen].max(axis=1)
    out["seen"][keep] = seen
    out["n_images"][keep] = found.n_images.T
    out["probabilities"][keep] = found.probabilities.transpose(1, 0, 2)
    return out


def _segmented(views: Iterable[View], bundle: ModelBundle, scheme: ClassScheme) -> Iterator[SegmentedImage]:
    classes, network = image_classes(scheme), network_of(bundle)
    magnification = bundle.metadata["parameters"]["magnification"]

    def segmented(camera: Camera, read: Callable[[], NDArray[np.uint8]]) -> NDArray[np.float32]:
        given = segment_image(network, read(), magnification=magnification)
        flat = point_probabilities(given.reshape(-1, len(classes)), classes, scheme)
        return flat.reshape(camera.height, camera.width, len(scheme))

    for group, camera, read in views:
        yield group, camera, partial(segmented, camera, read)
