"""Results of the stages that all methods share: ground, heights, supervoxels and their features."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array


class GroundMask(TypedDict):
    """Ground points of a scene."""

    ground: NDArray[np.bool_]  # True for ground points


class Ground(GroundMask):
    """Ground points of a scene and heights above them."""

    # Height above the ground in metres; NaN for outliers, and for all points of a scene without ground
    height: NDArray[np.float32]


class SupervoxelPartition(TypedDict):
    """Partition of a scene into supervoxels."""

    labels: NDArray[np.int32]  # Supervoxel of each point; -1 for outliers
    adjacency: csr_array  # First-order neighbours of each supervoxel


class SupervoxelTable(TypedDict):
    """Features of the supervoxels of a scene."""

    values: NDArray[np.float32]  # One row a supervoxel, one column a feature
    names: NDArray[np.str_]  # Names of the features
    centroids: NDArray[np.float64]  # Mean of the supervoxel's points in metres
    counts: NDArray[np.int64]  # Points of each supervoxel
