"""Predictions for the points of a scene, as stored mappings of arrays."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud


class PointLabels(TypedDict):
    """Labels of a scene's points."""

    label: NDArray[np.int16]  # Classes of the model's scheme; -1 where the method assigns none
    confidence: NDArray[np.float32]  # Probability or score of the class, 0 to 1; 0 without a class


class ImagePredictions(PointLabels):
    """Labels of a scene's points from images, with the predictions of each camera."""

    seen: NDArray[np.bool_]  # Points that at least one image shows
    n_images: NDArray[np.int16]  # Number of images of each camera that show a point
    # Class probabilities per camera; NaN where no image of the camera shows the point
    probabilities: NDArray[np.float16]


def unlabelled(n: int) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return new labels and confidences of points without a class."""
    return np.full(n, IGNORE, dtype=np.int16), np.zeros(n, dtype=np.float32)


def core_labels(scene: PointCloud, scheme: ClassScheme) -> NDArray[np.int16]:
    """Return the true classes of the points of a training scene; -1 outside its core."""
    labels = scheme.encode(scene["label"], source=scene.source)
    return np.where(scene["core"], labels, np.int16(IGNORE)) if "core" in scene else labels
