"""Thinned points of a labelled scene for the pictures of the report."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells

VOXEL = 0.1
"""Edge length of the voxels that keep one point each, metres."""
MOST_POINTS = 150_000
"""Largest number of points of a scene; of more voxels, evenly spaced ones are kept."""


class PictureSample(TypedDict):
    """Points of a scene and its buffers, relative to `origin`: label (-1 without a class), whether in the core."""

    xyz: NDArray[np.float32]
    origin: NDArray[np.float64]
    label: NDArray[np.int16]
    core: NDArray[np.bool_]


def scene_sample(
    xyz: NDArray[np.floating], origin: NDArray[np.float64], label: NDArray[np.integer], core: NDArray[np.bool_]
) -> PictureSample:
    """Return the first point of each voxel, in the order of the scene."""
    first = first_in_cells(xyz, VOXEL)
    kept = first[:: max(1, -(-len(first) // MOST_POINTS))]
    return {
        "xyz": xyz[kept].astype(np.float32),
        "origin": np.asarray(origin, dtype=np.float64),
        "label": label[kept].astype(np.int16),
        "core": core[kept],
    }
