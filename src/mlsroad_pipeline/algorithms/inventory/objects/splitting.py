"""Separation of touching trees at the valleys of the canopy."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.object_voxels import Voxels


def split_at_valleys(voxels: Voxels, *, spacing: float, depth: float, cell: float = 0.5) -> NDArray[np.int32]:
    """Split a group of touching trees into single trees.

    Watershed segmentation of the canopy height model, from the tops down. Two tops whose basins meet are merged if the
    valley is less than `depth` below the lower top or the tops are nearer than `spacing`.
    """
    ij = np.floor(voxels.xyz[:, :2] / cell).astype(np.int64)
    ij -= ij.min(axis=0) - 1
    shape = ij.max(axis=0) + 2
    canopy = np.full(tuple(shape), -np.inf)
    np.maximum.at(canopy, (ij[:, 0], ij[:, 1]), voxels.z_high)
    order = np.argsort(-canopy, axis=None, kind="stable")[: int(np.isfinite(canopy).sum())]
    part = _flood(canopy.ravel(), order, int(shape[1]), spacing / cell, depth)
    _, label = np.unique(part[order], return_index=True)
    number = {int(part[order[first]]): rank for rank, first in enumerate(np.sort(label))}
    cells = part[ij[:, 0] * shape[1] + ij[:, 1]]
    return np.array([number[int(c)] for c in cells], dtype=np.int32)


@njit(cache=True)
def _flood(
    height: NDArray[np.float64], order: NDArray[np.int64], stride: int, spacing: float, depth: float
) -> NDArray[np.int64]:
    """Return the cell of the top for each cell of the canopy, -1 outside; `order` is from the highest cell down."""
    top = np.full(len(height), -1, np.int64)  # top of each cell before merging
    joined = np.arange(len(height))  # higher top that a top is merged into
    for cell in order:
        best = -1
        for di in range(-1, 2):
            for dj in range(-1, 2):
                other = top[cell + di * stride + dj]
                if other < 0:
                    continue
                while joined[other] != other:
                    other = joined[other]
                if best < 0:
                    best = other
                elif other != best:
                    high, low = (best, other) if height[best] >= height[other] else (other, best)
                    apart = np.hypot(high // stride - low // stride, high % stride - low % stride)
                    if height[low] - height[cell] < depth or apart < spacing:
                        joined[low] = high
                    best = high
        top[cell] = best if best >= 0 else cell
    for cell in order:
        while joined[top[cell]] != top[cell]:
            top[cell] = joined[top[cell]]
    return top
