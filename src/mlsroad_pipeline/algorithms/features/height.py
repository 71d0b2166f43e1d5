"""Height features of supervoxels: vertical extent, and height above the ground (Tomic et al. 2019, section 2.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.supervoxel_moments import SupervoxelMoments, summarise_column

GROUND_HEIGHT_FEATURES = (
    "height_above_ground_mean",
    "height_above_ground_min",
    "height_above_ground_max",
    "height_above_ground_std",
)
"""Columns of `describe_ground_height`."""

OWN_HEIGHT_FEATURES = ("height_range", "height_std")
"""Columns of `describe_own_height`."""


def describe_own_height(moments: SupervoxelMoments) -> NDArray[np.float32]:
    """Return the vertical extent and spread of supervoxels."""
    spread = np.sqrt(np.maximum(moments.covariances[5], 0.0))
    return np.stack([moments.z_range[:, 1] - moments.z_range[:, 0], spread], axis=1).astype(np.float32)


def describe_ground_height(
    height_above_ground: NDArray[np.floating], labels: NDArray[np.int32], n_supervoxels: int
) -> NDArray[np.float32]:
    """Return statistics of the height above ground of each supervoxel."""
    heights = summarise_column(height_above_ground, labels, n_supervoxels)
    return np.stack([heights.mean, heights.minimum, heights.maximum, heights.std], axis=1).astype(np.float32)
