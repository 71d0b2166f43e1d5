"""Associative Markov network over patches: graph with features, boosted scores, and inference (Munoz et al. 2009)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from sklearn.tree import DecisionTreeRegressor

from mlsroad_pipeline.algorithms.core.validation import check_tested
from mlsroad_pipeline.algorithms.energy.robust_potts import Cliques, minimize
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

    @property
    def clique_of_member(self) -> NDArray[np.int64]:
        """Clique of each entry of `members`."""
        return np.repeat(np.arange(len(self.sizes)), self.sizes)


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


@njit(cache=True, nogil=True)
def _add_trees(
    features: NDArray[np.float32],
    roots: NDArray[np.int64],
    column: NDArray[np.int16],
    threshold: NDArray[np.float64],
    child: NDArray[np.int32],
    value: NDArray[np.float32],
    total: NDArray[np.float64],
) -> None:
    for tree in range(len(roots) - 1):
        for row in range(len(features)):
            node = roots[tree]
            while column[node] >= 0:
                right = features[row, column[node]] > threshold[node]
                node = roots[tree] + child[node, np.int64(right)]
            for k in range(total.shape[1]):
                total[row, k] += value[node, k]


class BoostedTrees:
    """Sum of regression trees, initially zero."""

    def __init__(self, n_values: int) -> None:
        self.n_values = n_values
        self._arrays: dict[str, NDArray] = {
            "roots": np.zeros(1, np.int64), "column": np.zeros(0, np.int16), "threshold": np.zeros(0, np.float64),
            "child": np.zeros((0, 2), np.int32), "value": np.zeros((0, n_values), np.float32),
        }  # fmt: skip

    def __len__(self) -> int:
        """Return the number of trees."""
        return len(self._arrays["roots"]) - 1

    def grow(
        self,
        features: NDArray[np.float32],
        target: NDArray[np.floating],
        weight: NDArray[np.floating],
        *,
        step: float,
        max_depth: int,
        min_samples_leaf: int,
        seed: int,
    ) -> None:
        """Fit a tree to a functional gradient by weighted least squares and add it."""
        if len(features) == 0 or not target.any():
            return
        fitted = DecisionTreeRegressor(
            max_depth=max_depth, min_samples_leaf=min(min_samples_leaf, len(features)), random_state=seed
        ).fit(features, target, sample_weight=weight)
        tree = fitted.tree_
        grown = {
            "roots": self._arrays["roots"][-1:] + tree.node_count,
            "column": np.where(tree.children_left < 0, -1, tree.feature).astype(np.int16),
            "threshold": tree.threshold,
            "child": np.stack([tree.children_left, tree.children_right], axis=1).astype(np.int32),
            "value": (step * tree.value.reshape(tree.node_count, self.n_values)).astype(np.float32),
        }
        self._arrays = {name: np.concatenate([before, grown[name]]) for name, before in self._arrays.items()}

    def predict(self, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the sum of the trees."""
        check_tested(self._arrays["column"], features.shape[1], "boosted trees")
        total = np.zeros((len(features), self.n_values))
        _add_trees(np.ascontiguousarray(features, dtype=np.float32), *self._arrays.values(), total)
        return total

    def to_arrays(self, prefix: str) -> dict[str, NDArray]:
        """Return the trees as named arrays."""
        return {f"{prefix}_{name}": values for name, values in self._arrays.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], prefix: str) -> Self:
        """Rebuild the trees from the arrays of `to_arrays`."""
        trees = cls(arrays[f"{prefix}_value"].shape[1])
        trees._arrays = {name: arrays[f"{prefix}_{name}"] for name in trees._arrays}
        return trees


PARTS = ("sites", "pairs", "groups")
_CYCLES = 5
"""Maximum cycles of alpha-expansion; further cycles hardly lower the energy."""


def _label_counts(graph: MarkovGraph, labels: NDArray[np.integer], n_labels: int) -> NDArray[np.float64]:
    """Return the number of members of each clique with each label."""
    counts = np.zeros((len(graph.sizes), n_labels))
    np.add.at(counts, (graph.clique_of_member, labels[graph.members]), 1.0)
    return counts


def clique_shares(
    graph: MarkovGraph, labels: NDArray[np.integer], n_labels: int, truncation: float
) -> NDArray[np.float64]:
    """Return the consistency (c, n_labels) of each label with each clique.

    It is 1 if all members have the label, and decreases linearly to 0 at a fraction `truncation` of deviating members.
    """
    size = graph.sizes[:, None]
    return np.maximum(1.0 - (size - _label_counts(graph, labels, n_labels)) / (truncation * size), 0.0)


def _add_pairs(
    scores: NDArray[np.float64], labels: NDArray[np.int32], edges: NDArray[np.int32], agreement: NDArray[np.float64]
) -> None:
    ends, others = edges.ravel(), labels[edges[:, ::-1].ravel()]
    np.add.at(scores, (ends, others), agreement[np.repeat(np.arange(len(edges)), 2), others])


def _add_groups(
    scores: NDArray[np.float64],
    labels: NDArray[np.int32],
    graph: MarkovGraph,
    reward: NDArray[np.float64],
    truncation: float,
) -> None:
    n_labels = scores.shape[1]
    size, unit = graph.sizes[:, None, None, None], np.eye(n_labels)
    # Score of a clique after one member changes from label a to k: axes are clique, a, k, and the label that counts.
    have = _label_counts(graph, labels, n_labels)[:, None, None] + unit - unit[:, None]
    worth = (reward[:, None, None] * (1.0 - (size - have) / (truncation * size))).max(axis=3, initial=0.0)
    np.add.at(scores, graph.members, worth[graph.clique_of_member, labels[graph.members]])


class MarkovNetwork:
    """Scores of sites, of agreeing pairs and of mostly agreeing cliques, each a sum of regression trees."""

    def __init__(self, n_labels: int, truncation: float) -> None:
        self.truncation = truncation
        self.trees = {part: BoostedTrees(n_labels) for part in PARTS}
        self.known = np.ones(n_labels, np.bool_)

    @property
    def n_labels(self) -> int:
        """Number of labels."""
        return len(self.known)

    def potentials(self, graph: MarkovGraph) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the scores of labels."""
        sites = self.trees["sites"].predict(graph.sites)
        agreement = np.maximum(self.trees["pairs"].predict(graph.pairs), 0.0)
        sizes = graph.sizes[:, None].astype(np.float64)
        reward: NDArray[np.float64] = np.maximum(self.trees["groups"].predict(graph.groups), 0.0) * sizes
        return sites, agreement, reward

    def best_labels(
        self,
        graph: MarkovGraph,
        potentials: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
        bonus: NDArray[np.float64] | float = 0.0,
    ) -> NDArray[np.int32]:
        """Return the labelling of maximum score, by alpha-expansion."""
        sites, agreement, reward = potentials
        unary = -(sites + bonus)
        unary[:, ~self.known] += 1e6
        n_cliques = len(graph.sizes)
        cliques = Cliques(
            graph.indptr, graph.members, -reward, np.zeros(n_cliques), np.maximum(self.truncation * graph.sizes, 1e-9)
        )
        labels, _ = minimize(unary, graph.edges, 0.0, cliques, agreement=agreement, max_cycles=_CYCLES)
        return labels

    def conditional_probabilities(self, graph: MarkovGraph, temperature: float) -> NDArray[np.float64]:
        """Return the probability of each label at each site, given the labels of all other sites.

        The label of the best labelling is the most probable one, since a change at one site is an expansion.
        """
        potentials = self.potentials(graph)
        labels = self.best_labels(graph, potentials)
        scores = potentials[0].copy()
        _add_pairs(scores, labels, graph.edges, potentials[1])
        _add_groups(scores, labels, graph, potentials[2], self.truncation)
        scores[:, ~self.known] = -np.inf
        scores = np.exp((scores - scores.max(axis=1, keepdims=True)) / temperature)
        return scores / scores.sum(axis=1, keepdims=True)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays."""
        arrays = {"known": self.known, "truncation": np.array(self.truncation)}
        for part, trees in self.trees.items():
            arrays.update(trees.to_arrays(part))
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a network from the arrays of `to_arrays`."""
        network = cls(len(arrays["known"]), float(arrays["truncation"]))
        network.known = arrays["known"].astype(np.bool_)
        network.trees = {part: BoostedTrees.from_arrays(arrays, part) for part in PARTS}
        return network
