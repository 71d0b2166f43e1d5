"""Voxels of an object of the inventory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Voxels:
    """Voxels of an object."""

    xyz: NDArray[np.float64]  # Mean point per voxel, world coordinates, metres
    low: NDArray[np.float64]  # Smallest and largest coordinates per voxel, metres
    high: NDArray[np.float64]  # Smallest and largest coordinates per voxel, metres
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
