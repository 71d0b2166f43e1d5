"""Results of the stages that all methods share: ground, heights, supervoxels and their features."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array


class GroundMask(TypedDict):
    """Ground points of a scene.

    Attributes
    ----------
    ground : ndarray of bool, shape (n,)
        True for ground points.
    """

    ground: NDArray[np.bool_]


class Ground(GroundMask):
    """Ground points of a scene and heights above them.

    Attributes
    ----------
    height : ndarray of float32, shape (n,)
        Height above the ground in metres; NaN for outliers, and for all points of a scene without ground.
    """

    height: NDArray[np.float32]


class SupervoxelPartition(TypedDict):
    """Partition of a scene into supervoxels.

    Attributes
    ----------
    labels : ndarray of int32, shape (n,)
        Supervoxel of each point; -1 for outliers.
    adjacency : csr_array of shape (s, s)
        First-order neighbours of each supervoxel.
    """

    labels: NDArray[np.int32]
    adjacency: csr_array


class SupervoxelTable(TypedDict):
    """Features of the supervoxels of a scene.

    Attributes
    ----------
    values : ndarray of float32, shape (s, f)
        One row a supervoxel, one column a feature.
    names : ndarray of str, shape (f,)
        Names of the features.
    centroids : ndarray of float64, shape (s, 3)
        Mean of the supervoxel's points in metres.
    counts : ndarray of int64, shape (s,)
        Points of each supervoxel.
    """

    values: NDArray[np.float32]
    names: NDArray[np.str_]
    centroids: NDArray[np.float64]
    counts: NDArray[np.int64]
