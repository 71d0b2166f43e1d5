"""Trees that touch, split into single ones at the valleys of their canopy."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.measures import Voxels


def split_at_valleys(voxels: Voxels, *, spacing: float, depth: float, cell: float = 0.5) -> NDArray[np.int32]:
    """Split a group of trees that touch into single ones.

    The highest points over a grid in plan make a canopy; it is flooded from the top. Where the water around two tops
    meets, they are one tree if the valley is less than `depth` below the lower top or the tops are nearer than
    `spacing`, and two otherwise.

    Parameters
    ----------
    voxels : Voxels
        The group.
    spacing : float
        The least distance between two trees' tops in plan, metres.
    depth : float
        The least depth of a valley below the lower top, metres.
    cell : float, default 0.5
        Edge of the grid, metres: coarser closes holes between branches, finer follows narrow valleys.

    Returns
    -------
    ndarray of int32, shape (k,)
        Part of each voxel, 0, 1, ... from the highest top down.
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
    """Return the top's cell for every cell of the canopy, -1 outside; cells arrive from the highest down."""
    top = np.full(len(height), -1, np.int64)  # the top whose water a cell is under, before tops are joined
    joined = np.arange(len(height))  # the higher top that swallowed a top
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
