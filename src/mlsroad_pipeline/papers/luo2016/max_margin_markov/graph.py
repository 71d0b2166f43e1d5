"""Graph of an associative Markov network over patches: sites, pairs and k-means cliques, with features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.papers.shared.patches.table import Patches

_KMEANS_ITERATIONS = 20


def kmeans_labels(points: NDArray[np.float64], n_clusters: int) -> NDArray[np.int32]:
    """Partition points by deterministic k-means (Lloyd 1982).

    The initial centres are points at equal steps of their order, which suits spatially ordered points. Empty clusters
    are removed.
    """
    offset = points - points.mean(axis=0)
    centres = offset[np.linspace(0, len(points) - 1, n_clusters).round().astype(np.int64)]
    nearest = np.full(len(points), -1)
    for _ in range(_KMEANS_ITERATIONS):
        before, (_, nearest) = nearest, cKDTree(centres).query(offset)
        if np.array_equal(before, nearest):
            break
        counts = np.bincount(nearest, minlength=len(centres))
        sums = np.stack([np.bincount(nearest, column, len(centres)) for column in offset.T], axis=1)
        centres = sums[counts > 0] / counts[counts > 0, None]
        nearest = (np.cumsum(counts > 0) - 1)[nearest]
    _, first, member = np.unique(nearest, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[member]


@dataclass(frozen=True, eq=False)
class MarkovGraph:
    """Sites, pairs and cliques of one scene."""

    sites: NDArray[np.float32]  # Features of the patches: histogram, colour (if available) and height
    edges: NDArray[np.int32]  # Pairs of patches
    pairs: NDArray[np.float32]  # Features of the pairs: differences in shape, colour and height, and mean height
    indptr: NDArray[np.int64]  # Start of each clique in `members`
    members: NDArray[np.int32]  # Patches of the cliques; a patch occurs at most once per segmentation
    # Features of the cliques: mean features of the patches, extent, and logarithm of the size
    groups: NDArray[np.float32]

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Number of patches of each clique."""
        return np.diff(self.indptr)


def _pair_features(patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.float32]:
    i, j = edges[:, 0], edges[:, 1]
    columns = [np.abs(patches.fpfh[i] - patches.fpfh[j]).sum(axis=1)]
    if patches.rgb is not None:
        columns.append(np.linalg.norm(patches.rgb[i] - patches.rgb[j], axis=1))
    columns += [np.abs(patches.height[i] - patches.height[j]), 0.5 * (patches.height[i] + patches.height[j])]
    return np.stack(columns, axis=1).astype(np.float32)


def _group_features(
    sites: NDArray[np.float32], centroid: NDArray[np.float64], indptr: NDArray[np.int64], members: NDArray[np.int32]
) -> NDArray[np.float32]:
    sizes = np.diff(indptr).astype(np.float64)
    place = centroid[members] - centroid.mean(axis=0)
    rows = np.concatenate([sites[members].astype(np.float64), place, place**2], axis=1)
    means = np.add.reduceat(rows, indptr[:-1], axis=0) / sizes[:, None]
    spread = np.maximum(means[:, -3:] - means[:, -6:-3] ** 2, 0.0)
    extent = np.sqrt(np.stack([spread[:, 0] + spread[:, 1], spread[:, 2]], axis=1))
    return np.concatenate([means[:, :-6], extent, np.log(sizes)[:, None]], axis=1).astype(np.float32)


def build_markov_graph(patches: Patches, edges: NDArray[np.int32], clique_shares: Sequence[float]) -> MarkovGraph:
    """Build the Markov graph of a scene.

    Cliques are the clusters of several k-means segmentations of the patch centroids (Luo et al. 2016, section IV-C;
    Munoz et al. 2009).
    """
    parts = [patches.fpfh, *([] if patches.rgb is None else [patches.rgb]), patches.height[:, None]]
    sites = np.concatenate(parts, axis=1).astype(np.float32)
    members, sizes = [], []
    for share in clique_shares:
        labels = kmeans_labels(patches.centroid, max(int(np.ceil(share * len(patches))), 1))
        counts = np.bincount(labels)
        order = np.argsort(labels, kind="stable").astype(np.int32)
        members.append(order[counts[labels[order]] > 1])
        sizes.append(counts[counts > 1])
    everyone = np.concatenate(members) if members else np.zeros(0, np.int32)
    indptr = np.cumsum([0, *(np.concatenate(sizes) if sizes else [])]).astype(np.int64)
    pairs = np.ascontiguousarray(edges, dtype=np.int32)
    groups = np.zeros((0, sites.shape[1] + 3), np.float32)
    if len(everyone):
        groups = _group_features(sites, patches.centroid, indptr, everyone)
    return MarkovGraph(sites, pairs, _pair_features(patches, pairs), indptr, everyone, groups)
