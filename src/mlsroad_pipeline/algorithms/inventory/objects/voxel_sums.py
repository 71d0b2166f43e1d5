"""Voxels of objects, aligned to world coordinates, so that voxels of neighbouring scenes coincide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import sort_into_cells


@dataclass(frozen=True)
class Voxels:
    """Voxels of an object."""

    xyz: NDArray[np.float64]  # Mean point per voxel, world coordinates, metres
    # low, high: smallest and largest coordinates per voxel, metres
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    ground: NDArray[np.float64]  # Mean elevation of the ground below, metres; NaN if unknown
    count: NDArray[np.int64]  # Points per voxel
    disagreeing: NDArray[np.int64]  # Points whose own label is of another class than the object
    confidence: NDArray[np.float64]  # Sum of the points' confidences
    scene: NDArray[np.int32]  # Number of the scene whose core contains the points

    @property
    def z_low(self) -> NDArray[np.float64]:
        """Elevation of the lowest point per voxel."""
        return self.low[:, 2]

    @property
    def z_high(self) -> NDArray[np.float64]:
        """Elevation of the highest point per voxel."""
        return self.high[:, 2]

    def select(self, index: NDArray) -> Voxels:
        """Return the voxels of an index array or mask."""
        return Voxels(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def voxelise(
    local: NDArray[np.float64],
    *,
    group: NDArray[np.int32],
    core: NDArray[np.bool_],
    confidence: NDArray[np.float64],
    height_above_ground: NDArray[np.float64] | None,
    origin: NDArray[np.float64],
    resolution: float,
    disagreeing: NDArray[np.bool_] | None = None,
) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Sum the points of objects over voxels."""
    cells = sort_into_cells(local, origin=origin, size=resolution)
    order, starts = cells.order, cells.starts[:-1]
    inside = _inside(local, order, cells.starts, cells.index, origin, resolution)
    weight = core[order]
    z = inside[:, 2]
    ground = np.full(len(z), np.nan) if height_above_ground is None else z - height_above_ground[order]
    low, high = _ends(inside, weight, cells.starts)
    table = {
        "fragment": group[order[starts]],
        **{name: cells.index[:, axis] for axis, name in enumerate("ijk")},
        **{name: np.add.reduceat(inside[:, axis] * weight, starts) for axis, name in enumerate("xyz")},
        **{f"{name}_low": low[axis] for axis, name in enumerate("xyz")},
        **{f"{name}_high": high[axis] for axis, name in enumerate("xyz")},
        "ground": np.add.reduceat(np.where(weight, ground, 0.0), starts),
        "count": np.add.reduceat(weight.astype(np.int64), starts),
        "disagreeing": np.zeros(len(starts), dtype=np.int64)
        if disagreeing is None or not disagreeing.any()
        else np.add.reduceat((weight & disagreeing[order]).astype(np.int64), starts),
        "confidence": np.add.reduceat(confidence[order] * weight, starts),
    }
    by_object = np.argsort(table["fragment"], kind="stable")
    place = np.empty(len(starts), dtype=np.int64)
    place[by_object] = np.arange(len(starts))
    return pd.DataFrame({name: values[by_object] for name, values in table.items()}), place[cells.owner()]


@njit(cache=True, nogil=True)
def _inside(
    local: NDArray[np.float64],
    order: NDArray[np.int32],
    starts: NDArray[np.int64],
    index: NDArray[np.int64],
    origin: NDArray[np.float64],
    resolution: float,
) -> NDArray[np.float64]:
    """Return the points in their order, relative to the corners of their voxels."""
    inside = np.empty(local.shape)
    for voxel in range(len(index)):
        for place in range(starts[voxel], starts[voxel + 1]):
            for axis in range(3):
                inside[place, axis] = local[order[place], axis] - (index[voxel, axis] * resolution - origin[axis])
    return inside


@njit(cache=True)
def _ends(
    inside: NDArray[np.float64], weight: NDArray[np.bool_], starts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest coordinates of the weighted points of each voxel, shape (3, voxels)."""
    low, high = np.full((3, len(starts) - 1), np.inf), np.full((3, len(starts) - 1), -np.inf)
    for voxel in range(len(starts) - 1):
        for point in range(starts[voxel], starts[voxel + 1]):
            if weight[point]:
                for axis in range(3):
                    low[axis, voxel] = min(low[axis, voxel], inside[point, axis])
                    high[axis, voxel] = max(high[axis, voxel], inside[point, axis])
    return low, high
