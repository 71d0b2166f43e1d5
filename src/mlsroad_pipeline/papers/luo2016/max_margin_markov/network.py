"""Associative Markov network with learned scores of sites, pairs and cliques."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.energy.robust_potts import Cliques, minimize
from mlsroad_pipeline.papers.luo2016.max_margin_markov.boosted_trees import BoostedTrees
from mlsroad_pipeline.papers.luo2016.max_margin_markov.graph import MarkovGraph

PARTS = ("sites", "pairs", "groups")
_CYCLES = 5
"""Maximum cycles of alpha-expansion; further cycles hardly lower the energy."""


@njit(cache=True, nogil=True)
def clique_shares(
    labels: NDArray[np.integer], indptr: NDArray[np.int64], members: NDArray[np.int32], n_labels: int, truncation: float
) -> NDArray[np.float64]:
    """Return the consistency (c, n_labels) of each label with each clique.

    It is 1 if all members have the label, and decreases linearly to 0 at a fraction `truncation` of deviating members.
    """
    suits = np.zeros((len(indptr) - 1, n_labels))
    for c in range(len(suits)):
        size = indptr[c + 1] - indptr[c]
        for s in range(indptr[c], indptr[c + 1]):
            suits[c, labels[members[s]]] += 1.0
        for k in range(n_labels):
            suits[c, k] = max(1.0 - (size - suits[c, k]) / (truncation * size), 0.0)
    return suits


@njit(cache=True, nogil=True)
def _add_pairs(
    scores: NDArray[np.float64], labels: NDArray[np.int32], edges: NDArray[np.int32], agreement: NDArray[np.float64]
) -> None:
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        scores[i, labels[j]] += agreement[e, labels[j]]
        scores[j, labels[i]] += agreement[e, labels[i]]


@njit(cache=True, nogil=True)
def _add_groups(
    scores: NDArray[np.float64],
    labels: NDArray[np.int32],
    indptr: NDArray[np.int64],
    members: NDArray[np.int32],
    reward: NDArray[np.float64],
    truncation: float,
) -> None:
    n_labels = scores.shape[1]
    worth = np.empty((n_labels, n_labels))
    count = np.empty(n_labels)
    for c in range(len(reward)):
        size = indptr[c + 1] - indptr[c]
        count[:] = 0.0
        for s in range(indptr[c], indptr[c + 1]):
            count[labels[members[s]]] += 1.0
        for a in range(n_labels):  # score of the clique after one member changes from label a to k
            for k in range(n_labels):
                worth[a, k] = 0.0
                for other in range(n_labels):
                    have = count[other] + (other == k) - (other == a)
                    worth[a, k] = max(worth[a, k], reward[c, other] * (1.0 - (size - have) / (truncation * size)))
        for s in range(indptr[c], indptr[c + 1]):
            for k in range(n_labels):
                scores[members[s], k] += worth[labels[members[s]], k]


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
        _add_groups(scores, labels, graph.indptr, graph.members, potentials[2], self.truncation)
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
