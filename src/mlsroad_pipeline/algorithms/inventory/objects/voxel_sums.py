"""Sums of points over voxels that are aligned to world coordinates, so that voxels of neighbouring scenes coincide."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort


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
    key = voxel_keys(local, origin, resolution)
    order = voxel_order(key)
    starts, voxel = runs_of_keys(key, order)
    inside = _inside(local, key, order, origin, resolution)
    weight = core[order]
    z = inside[:, 2]
    ground = np.full(len(z), np.nan) if height_above_ground is None else z - height_above_ground[order]
    low, high = _ends(inside, weight, starts)
    table = {
        "fragment": group[order[starts]],
        **{name: key[order[starts], axis] for axis, name in enumerate("ijk")},
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
    return pd.DataFrame({name: values[by_object] for name, values in table.items()}), place[voxel]


@njit(cache=True, nogil=True)
def voxel_keys(local: NDArray[np.float64], origin: NDArray[np.float64], resolution: float) -> NDArray[np.int64]:
    """Return the voxel indices of points."""
    key = np.empty(local.shape, np.int64)
    for i in range(len(local)):
        for axis in range(3):
            key[i, axis] = np.int64(np.floor((local[i, axis] + origin[axis]) / resolution))
    return key


@njit(cache=True, nogil=True)
def runs_of_keys(key: NDArray[np.int64], order: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the voxels of points from their sorted indices."""
    starts, voxel = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    n, before = 0, order[0]
    for place in range(len(order)):
        i = order[place]
        if place == 0 or key[i, 0] != key[before, 0] or key[i, 1] != key[before, 1] or key[i, 2] != key[before, 2]:
            starts[n] = place
            n += 1
        voxel[i], before = n - 1, i
    return starts[:n].copy(), voxel


@njit(cache=True, nogil=True)
def _inside(
    local: NDArray[np.float64],
    key: NDArray[np.int64],
    order: NDArray[np.integer],
    origin: NDArray[np.float64],
    resolution: float,
) -> NDArray[np.float64]:
    """Return the points in their order, relative to the corners of their voxels."""
    inside = np.empty(local.shape)
    for place in range(len(order)):
        i = order[place]
        for axis in range(3):
            inside[place, axis] = local[i, axis] - (key[i, axis] * resolution - origin[axis])
    return inside


@njit(cache=True)
def _ends(
    inside: NDArray[np.float64], weight: NDArray[np.bool_], starts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest coordinates of the weighted points of each voxel, shape (3, voxels)."""
    low, high = np.full((3, len(starts)), np.inf), np.full((3, len(starts)), -np.inf)
    for voxel in range(len(starts)):
        stop = starts[voxel + 1] if voxel + 1 < len(starts) else len(inside)
        for point in range(starts[voxel], stop):
            if weight[point]:
                for axis in range(3):
                    low[axis, voxel] = min(low[axis, voxel], inside[point, axis])
                    high[axis, voxel] = max(high[axis, voxel], inside[point, axis])
    return low, high


def voxel_order(key: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the order of voxels by i, then j, then k."""
    low, high = ([int(ends(key[:, axis])) for axis in range(3)] for ends in (np.min, np.max))
    bits = [(last - first).bit_length() for first, last in zip(low, high, strict=True)]
    if sum(bits) > 62:  # extent exceeds a packed key: slower, same order
        return np.lexsort((key[:, 2], key[:, 1], key[:, 0]))
    packed = np.zeros(len(key), np.int64)
    for axis, shift in enumerate((bits[1] + bits[2], bits[2], 0)):
        packed |= (key[:, axis].astype(np.int64) - low[axis]) << shift
    return radix_argsort(packed, sum(bits))[1]
