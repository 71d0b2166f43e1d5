"""Reduction of labelled points to voxels, and fragments of objects that lie in several scenes.

Voxels are aligned to world coordinates, so that the voxels of neighbouring scenes coincide.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort
from mlsroad_pipeline.algorithms.inventory.object_voxels import Voxels
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

FRAGMENT_FIELDS = {
    "class": "str",
    "fragment": "int32",
    "i": "int64",
    "j": "int64",
    "k": "int64",
    "x": "float64",
    "y": "float64",
    "z": "float64",
    "x_low": "float64",
    "x_high": "float64",
    "y_low": "float64",
    "y_high": "float64",
    "z_low": "float64",
    "z_high": "float64",
    "ground": "float64",
    "count": "int64",
    "disagreeing": "int64",
    "confidence": "float64",
}
"""Columns of a fragment table: sums over the core points of a voxel, and their smallest and largest coordinates. For
precision, coordinates are relative to the corner of the voxel and `ground` to its lower face. `disagreeing` counts the
points whose own label is of another class. A voxel of buffer points alone has a count of 0."""


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
    """Sum the points of objects over voxels.

    Parameters
    ----------
    local : ndarray of float64, shape (n, 3)
        Points relative to `origin`, metres.
    group : ndarray of int32, shape (n,)
        Object of each point; no voxel may contain points of two objects.
    core : ndarray of bool, shape (n,)
        Points to sum; the others only occupy their voxel.
    confidence : ndarray of float64, shape (n,)
        Confidences.
    height_above_ground : ndarray of float64, shape (n,), or None
        Heights, metres; None if unknown.
    origin : ndarray of float64, shape (3,)
        World coordinates of the local origin, metres.
    resolution : float
        Edge length of the voxels, metres.
    disagreeing : ndarray of bool, shape (n,), optional
        Points whose own label is of another class than the object; None is none.

    Returns
    -------
    table : DataFrame
        Columns of `FRAGMENT_FIELDS` except the class, sorted by fragment and voxel.
    row : ndarray of int64, shape (n,)
        Row of the voxel of each point.
    """
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
    """Return the voxel indices of points.

    Parameters
    ----------
    local : ndarray of float64, shape (n, 3)
        Points relative to `origin`, metres.
    origin : ndarray of float64, shape (3,)
        World coordinates of the local origin, metres.
    resolution : float
        Edge length of the voxels, metres.

    Returns
    -------
    ndarray of int64, shape (n, 3)
        Voxel indices.
    """
    key = np.empty(local.shape, np.int64)
    for i in range(len(local)):
        for axis in range(3):
            key[i, axis] = np.int64(np.floor((local[i, axis] + origin[axis]) / resolution))
    return key


@njit(cache=True, nogil=True)
def runs_of_keys(key: NDArray[np.int64], order: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the voxels of points from their sorted indices.

    Parameters
    ----------
    key : ndarray of int64, shape (n, 3)
        Voxel indices of points; at least one.
    order : ndarray of int, shape (n,)
        Their order, see `voxel_order`.

    Returns
    -------
    starts : ndarray of int64
        Place in the order of the first point of each voxel.
    voxel : ndarray of int64, shape (n,)
        Voxel of each point.
    """
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
    """Return the order of voxels by i, then j, then k.

    Parameters
    ----------
    key : ndarray of int, shape (n, 3)
        Voxel indices; at least one.

    Returns
    -------
    ndarray of int, shape (n,)
        Stable sort order.
    """
    low, high = ([int(ends(key[:, axis])) for axis in range(3)] for ends in (np.min, np.max))
    bits = [(last - first).bit_length() for first, last in zip(low, high, strict=True)]
    if sum(bits) > 62:  # extent exceeds a packed key: slower, same order
        return np.lexsort((key[:, 2], key[:, 1], key[:, 0]))
    packed = np.zeros(len(key), np.int64)
    for axis, shift in enumerate((bits[1] + bits[2], bits[2], 0)):
        packed |= (key[:, axis].astype(np.int64) - low[axis]) << shift
    return radix_argsort(packed, sum(bits))[1]


def find_fragments(
    local: NDArray[np.float64],
    *,
    core: NDArray[np.bool_],
    confidence: NDArray[np.float64],
    height_above_ground: NDArray[np.float64] | None,
    origin: NDArray[np.float64],
    rule: ObjectRule,
    disagreeing: NDArray[np.bool_] | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame, NDArray[np.int64], NDArray[np.int64]]:
    """Cluster the points of one class and reduce the clusters to voxels.

    Parameters
    ----------
    local : ndarray of float64, shape (n, 3)
        Points of the class in core and buffer, relative to `origin`, metres.
    core : ndarray of bool, shape (n,)
        Points in the scene's core.
    confidence : ndarray of float64, shape (n,)
        Confidences.
    height_above_ground : ndarray of float64, shape (n,), or None
        Heights, metres; None if unknown.
    origin : ndarray of float64, shape (3,)
        World coordinates of the local origin, metres.
    rule : ObjectRule
        Tolerances and resolution.
    disagreeing : ndarray of bool, shape (n,), optional
        Points whose own label is of another class; None is none.

    Returns
    -------
    whole, cut : DataFrame
        Voxels of the clusters that lie wholly in the core and have `rule.min_points`, and of those that extend from the
        core into the buffer. Clusters wholly in the buffer belong to neighbouring scenes and are dropped.
    of_whole, of_cut : ndarray of int64, shape (n,)
        Row of each point in either table, -1 for none.
    """
    # Scaling z by the ratio of the tolerances makes the vertical tolerance equal to the horizontal one.
    squeeze = np.array([1.0, 1.0, rule.tolerance / (rule.vertical_tolerance or rule.tolerance)])
    label = cluster(local * squeeze, tolerance=rule.tolerance)
    n_clusters = int(label.max(initial=-1)) + 1
    size = np.bincount(label, minlength=n_clusters)
    n_core = np.bincount(label[core], minlength=n_clusters)
    crosses = (n_core > 0) & (n_core < size)
    kept = crosses | ((n_core == size) & (size >= rule.min_points))
    pick = kept[label]
    of_whole, of_cut = np.full((2, len(local)), -1, dtype=np.int64)
    if not pick.any():
        empty = pd.DataFrame({name: pd.Series(dtype=dtype) for name, dtype in FRAGMENT_FIELDS.items()})
        return empty.drop(columns="class"), empty.drop(columns="class"), of_whole, of_cut
    voxels, row = voxelise(
        local[pick],
        group=label[pick],
        core=core[pick],
        confidence=confidence[pick],
        height_above_ground=None if height_above_ground is None else height_above_ground[pick],
        origin=origin,
        resolution=rule.resolution,
        disagreeing=None if disagreeing is None else disagreeing[pick],
    )
    cut = crosses[voxels["fragment"].to_numpy()]
    of_whole[pick] = np.where(cut, -1, np.cumsum(~cut) - 1)[row]
    of_cut[pick] = np.where(cut, np.cumsum(cut) - 1, -1)[row]
    return voxels[~cut].reset_index(drop=True), voxels[cut].reset_index(drop=True), of_whole, of_cut


def join_voxels(table: pd.DataFrame, *, resolution: float) -> tuple[Voxels, NDArray[np.int64], NDArray[np.int64]]:
    """Convert voxel sums to mean points; the sums of a voxel in several scenes are added.

    Parameters
    ----------
    table : DataFrame
        Columns of `FRAGMENT_FIELDS`, the `object` number and the `scene` number of each row.
    resolution : float
        Edge length of the voxels, metres.

    Returns
    -------
    voxels : Voxels
        Voxels with points, sorted by object and voxel.
    number : ndarray of int64
        Object of each voxel.
    joined : ndarray of int64, shape (len(table),)
        Voxel of each row, -1 for rows without points.

    Raises
    ------
    DataError
        If an object has no points: fragments of a scene that it extends into are missing.
    """
    filled = (table["count"] > 0).to_numpy()
    rows = table[filled]
    lost = np.setdiff1d(table["object"], rows["object"])
    if len(lost):
        raise DataError(f"{len(lost)} objects have voxels but no points: fragments of a scene are missing")
    key = rows[["object", "i", "j", "k", "scene"]].to_numpy()
    order = np.lexsort(key.T[::-1])
    key = key[order]
    new = np.concatenate([[True], (np.diff(key[:, :4], axis=0) != 0).any(axis=1)])
    starts = np.flatnonzero(new)

    def reduced(name: str, ufunc: np.ufunc = np.add) -> NDArray:
        return ufunc.reduceat(rows[name].to_numpy()[order], starts)

    # A voxel on a border belongs to the scene with most of its points; ties go to the first scene.
    part = rows["count"].to_numpy()[order]
    voxel = np.cumsum(new) - 1
    most = np.lexsort((key[:, 4], -part, voxel))[starts]
    corner = key[starts, 1:4] * resolution
    joined = np.full(len(table), -1, dtype=np.int64)
    joined[np.flatnonzero(filled)[order]] = voxel
    n = reduced("count")
    return (
        Voxels(
            # Rounded to 0.01 mm: the measures must not depend on the order of the scenes.
            xyz=np.round(corner + np.column_stack([reduced(name) for name in "xyz"]) / n[:, None], 5),
            low=corner + np.column_stack([reduced(f"{name}_low", np.minimum) for name in "xyz"]),
            high=corner + np.column_stack([reduced(f"{name}_high", np.maximum) for name in "xyz"]),
            ground=corner[:, 2] + reduced("ground") / n,
            count=n,
            disagreeing=reduced("disagreeing"),
            confidence=reduced("confidence"),
            scene=key[most, 4].astype(np.int32),
        ),
        key[starts, 0],
        joined,
    )
