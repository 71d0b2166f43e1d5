"""Point labels of a scene."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE


class SceneLabels(TypedDict):
    """Class and confidence of every point of a scene.

    Attributes
    ----------
    label : ndarray of int16, shape (n,)
        Class of the model's scheme; -1 where the method assigns none.
    confidence : ndarray of float32, shape (n,)
        Probability or score of the class, 0 to 1; 0 where there is no class.
    """

    label: NDArray[np.int16]
    confidence: NDArray[np.float32]


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
