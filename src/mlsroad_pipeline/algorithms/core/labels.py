"""Predictions for the points of a scene, as stored mappings of arrays."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE


class PointLabels(TypedDict):
    """Labels of a scene's points.

    Attributes
    ----------
    label : ndarray of int16, shape (n,)
        Classes of the model's scheme; -1 where the method assigns none.
    confidence : ndarray of float32, shape (n,)
        Probability or score of the class, 0 to 1; 0 without a class.
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


def unlabelled(n: int) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return new labels and confidences of points without a class.

    Parameters
    ----------
    n : int
        Number of points.

    Returns
    -------
    label : ndarray of int16, shape (n,)
        -1 throughout.
    confidence : ndarray of float32, shape (n,)
        0 throughout.
    """
    return np.full(n, IGNORE, dtype=np.int16), np.zeros(n, dtype=np.float32)
