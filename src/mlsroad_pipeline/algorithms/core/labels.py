"""Predictions for the points of a scene, as they are stored: mappings of arrays."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray


class PointLabels(TypedDict):
    """Labels of a scene's points.

    Attributes
    ----------
    label : ndarray of int16, shape (n,)
        Labels of the class scheme, -1 for none.
    confidence : ndarray of float32, shape (n,)
        Confidence of the labels, 0 to 1.
    """

    label: NDArray[np.int16]
    confidence: NDArray[np.float32]


class ImagePredictions(PointLabels):
    """Labels of a scene's points from images, with the predictions of each camera.

    Attributes
    ----------
    seen : ndarray of bool, shape (n,)
        Points that at least one image shows.
    n_images : ndarray of int16, shape (n, groups)
        Number of images of each camera that show a point.
    probabilities : ndarray of float16, shape (n, groups, classes)
        Class probabilities per camera; NaN where no image of the camera shows the point.
    """

    seen: NDArray[np.bool_]
    n_images: NDArray[np.int16]
    probabilities: NDArray[np.float16]
