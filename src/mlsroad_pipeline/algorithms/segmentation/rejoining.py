"""Merging of floating parts with their neighbours, and of pole segments across a gap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.graphs import connected_components

_FOOT_SHARE = 0.005  # share of a part's voxels below its foot: half a crown may contain a few of an object under it
_END = 0.6  # length of the ends of a part that are compared, metres
_NARROW = 0.5  # largest width of the end of a pole, metres
_OFF_LINE = 0.2  # largest horizontal distance between two ends of one pole, metres


def rejoin_floating_parts(
    places: NDArray[np.float64],
    clusters: NDArray[np.int32],
    parts: NDArray[np.int64],
    *,
    foot_height: float,
    reach: float,
) -> NDArray[np.int64]:
    """Join each part that has no foot with the part of its cluster that it touches most.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 3)
        Voxels, metres, z up.
    clusters : ndarray of int32, shape (v,)
        Cluster of each.
    parts : ndarray of int64, shape (v,)
        Part of each, 0, 1, ...; a part lies in one cluster.
    foot_height : float
        A part has a foot where it reaches down to within this height above the lowest place of its cluster, metres. The
        lowest 0.5 % of its voxels are excluded. Larger keeps more parts.
    reach : float
        Voxels of two parts touch when they are at most this far apart, metres.

    Returns
    -------
    ndarray of int64, shape (v,)
        Parts, renumbered.
    """
    while True:
        joined = _rejoined(places, clusters, parts, foot_height, reach)
        # Floating parts that touch only each other may touch a part with a foot once they are merged.
        if joined.max(initial=-1) == parts.max(initial=-1):
            return joined
        parts = joined


def _rejoined(
    places: NDArray[np.float64], clusters: NDArray[np.int32], parts: NDArray[np.int64], foot_height: float, reach: float
) -> NDArray[np.int64]:
    """Join each part without a foot once; the same numbers where none can be joined."""
    if len(parts) == 0:
        return parts
    n = int(parts.max()) + 1
    of_part = np.zeros(n, np.int64)
    of_part[parts] = clusters
    low, bottom = _feet(places[:, 2], parts), np.full(int(clusters.max()) + 1, np.inf)
    np.minimum.at(bottom, clusters, places[:, 2])
    floating = np.isfinite(low) & (low - bottom[of_part] > foot_height)
    busy = np.bincount(of_part[floating], minlength=len(bottom)) > 0
    rows = np.flatnonzero(busy[clusters])
    if len(rows) == 0:
        return parts
    pairs = rows[cKDTree(places[rows]).query_pairs(reach, output_type="ndarray")]
    pairs = pairs[(clusters[pairs[:, 0]] == clusters[pairs[:, 1]]) & (parts[pairs[:, 0]] != parts[pairs[:, 1]])]
    sides = np.concatenate([parts[pairs], parts[pairs[:, ::-1]]])
    touch, count = np.unique(sides[floating[sides[:, 0]]], axis=0, return_counts=True)
    order = np.lexsort((touch[:, 1], -count, touch[:, 0]))
    best = order[np.unique(touch[order, 0], return_index=True)[1]]
    return connected_components(touch[best], n_nodes=n)[parts].astype(np.int64)


def _feet(heights: NDArray[np.float64], parts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the height of each part's foot; infinity for unused numbers."""
    order = np.lexsort((heights, parts))
    count = np.bincount(parts)
    there = np.flatnonzero(count)
    rows = (np.cumsum(count) - count + (_FOOT_SHARE * count).astype(np.int64))[there]
    feet = np.full(len(count), np.inf)
    feet[there] = heights[order[rows]]
    return feet


def join_stacked_poles(
    places: NDArray[np.float64], parts: NDArray[np.int64], *, max_gap: float, min_height: float = 1.0
) -> NDArray[np.int64]:
    """Merge the parts of a pole below and above a gap, which was occluded or assigned to a crown.

    Parameters
    ----------
    places : ndarray of float64, shape (v, 3)
        Voxels, metres, z up.
    parts : ndarray of int64, shape (v,)
        Part of each, 0, 1, ...
    max_gap : float
        The longest gap, metres. Larger joins more; 0 joins nothing.
    min_height : float, default 1.0
        Least height of the part below the gap, metres.

    Returns
    -------
    ndarray of int64, shape (v,)
        Parts, renumbered.
    """
    if len(parts) == 0 or max_gap == 0:
        return parts
    top, high, narrow_top = _ends(places, parts, 1.0)
    bottom, low, narrow_bottom = _ends(places, parts, -1.0)
    tall = high - low
    under = np.flatnonzero(narrow_top & (tall >= min_height))
    over = np.flatnonzero(narrow_bottom & (tall >= _END))
    if len(under) == 0 or len(over) == 0:
        return parts
    pairs = []
    for k, near in zip(over, cKDTree(top[under]).query_ball_point(bottom[over], _OFF_LINE), strict=True):
        gap = low[k] - high[under[near]]
        good = (gap > -0.5 * _END) & (gap <= max_gap) & (under[near] != k)
        if good.any():
            pairs.append((k, under[np.asarray(near)[good][np.argmin(gap[good])]]))
    if not pairs:
        return parts
    return connected_components(np.array(pairs, dtype=np.int64), n_nodes=len(high))[parts].astype(np.int64)


def _ends(
    places: NDArray[np.float64], parts: NDArray[np.int64], sign: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return the middle of the upper (1) or lower (-1) end of each part, its height, and whether the end is narrow."""
    n = int(parts.max()) + 1
    height = np.full(n, -np.inf)
    np.maximum.at(height, parts, sign * places[:, 2])
    rows = np.flatnonzero(sign * places[:, 2] >= height[parts] - _END)
    owner, xy = parts[rows], places[rows, :2]
    count = np.maximum(np.bincount(owner, minlength=n), 1)
    middle = np.column_stack([np.bincount(owner, xy[:, axis], minlength=n) / count for axis in range(2)])
    least, most = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    np.minimum.at(least, owner, xy)
    np.maximum.at(most, owner, xy)
    return middle, sign * height, (most - least).max(axis=1) <= _NARROW
