"""Parts that hang in the air given back to what they were cut from: what stands in a street stands on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.graphs import connected_components


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
        A part has a foot where it comes down to within this height above the lowest place of its cluster, metres.
        Larger keeps more parts.
    reach : float
        Voxels of two parts touch when they are at most this far apart, metres.

    Returns
    -------
    ndarray of int64, shape (v,)
        Parts, numbered anew.
    """
    if len(parts) == 0:
        return parts
    n = int(parts.max()) + 1
    of_part = np.zeros(n, np.int64)
    of_part[parts] = clusters
    low, bottom = np.full(n, np.inf), np.full(int(clusters.max()) + 1, np.inf)
    np.minimum.at(low, parts, places[:, 2])
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
