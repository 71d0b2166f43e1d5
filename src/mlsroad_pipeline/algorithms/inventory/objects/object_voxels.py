"""Voxels of an object of the inventory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Voxels:
    """Voxels of an object.

    Parameters
    ----------
    xyz : ndarray of float64, shape (k, 3)
        Mean point per voxel, world coordinates, metres.
    low, high : ndarray of float64, shape (k, 3)
        Smallest and largest coordinates per voxel, metres.
    ground : ndarray of float64, shape (k,)
        Mean elevation of the ground below, metres; NaN if unknown.
    count : ndarray of int64, shape (k,)
        Points per voxel.
    disagreeing : ndarray of int64, shape (k,)
        Points whose own label is of another class than the object.
    confidence : ndarray of float64, shape (k,)
        Sum of the points' confidences.
    scene : ndarray of int32, shape (k,)
        Number of the scene whose core contains the points.
    """

    xyz: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    ground: NDArray[np.float64]
    count: NDArray[np.int64]
    disagreeing: NDArray[np.int64]
    confidence: NDArray[np.float64]
    scene: NDArray[np.int32]

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
