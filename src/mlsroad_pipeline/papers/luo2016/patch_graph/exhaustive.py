"""Exhaustive search: selected nodes are compared with all others (Luo et al. 2016, section III-B.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.papers.luo2016.patch_graph.costs import block_costs, bounded_cost
from mlsroad_pipeline.papers.luo2016.patch_graph.moves import insert, largest, slot_of
from mlsroad_pipeline.papers.luo2016.patch_graph.patch_index import PatchIndex
from mlsroad_pipeline.papers.shared.patches.table import UNKNOWN

_BLOCK = 1024  # patches that fit the cache of a core


def minority_classes(labels: NDArray[np.int16]) -> list[int]:
    """Return the classes with less than half of an equal share of the labelled patches."""
    classes, counts = np.unique_counts(labels[labels != UNKNOWN])
    return [int(c) for c, n in zip(classes, counts, strict=True) if 2 * n * len(classes) < counts.sum()]


class NodeChooser:
    """Selection of nodes for the exhaustive search, each at most once."""

    def __init__(
        self, labels: NDArray[np.int16], *, minority: Sequence[int], minority_share: float, n_costly: int, seed: int
    ) -> None:
        self._minority = np.flatnonzero(np.isin(labels, list(minority)))
        self._n_minority = int(np.ceil(minority_share * len(self._minority)))
        self._n_costly = n_costly
        self._random = np.random.default_rng(seed)
        self._done = np.zeros(len(labels), bool)

    @property
    def exhausted(self) -> bool:
        """Whether all nodes have been searched; the graph is then optimal."""
        return bool(self._done.all())

    def choose(self, costs: NDArray[np.float32]) -> NDArray[np.int32]:
        """Select nodes with probability proportional to the cost of their best match, and nodes of minority classes."""
        left = np.flatnonzero(~self._done)
        # Weighted sampling without replacement by the largest keys (Efraimidis and Spirakis).
        keys = np.log(self._random.random(len(left))) / np.maximum(costs[left].min(axis=1), 1e-12)
        n = min(self._n_costly, len(left))
        costly = left[np.argpartition(-keys, n - 1)[:n]] if n else left[:0]
        rare = self._minority[~self._done[self._minority]]
        drawn = self._random.choice(rare, min(self._n_minority, len(rare)), replace=False)
        chosen = np.union1d(costly, drawn)
        self._done[chosen] = True
        return chosen.astype(np.int32)


@njit(cache=True, nogil=True)
def search_all_targets(
    source: PatchIndex,
    target: PatchIndex,
    same: bool,
    nodes: NDArray[np.int32],
    first: int,
    last: int,
    matches: NDArray[np.int32],
    costs: NDArray[np.float32],
) -> None:
    """Write the best matches of the nodes at positions `first` to `last` of `nodes`.

    All nodes are compared with a block of targets before the next block, so that the targets are read once.
    """
    table, targets = source.table, target.table
    scenes = np.empty((last - first, matches.shape[1]), np.int32)
    block, nearby = np.empty((targets.shape[1], _BLOCK), np.float32), np.empty(_BLOCK, np.float32)
    for i in range(first, last):
        for k in range(matches.shape[1]):
            scenes[i - first, k] = target.scene[matches[nodes[i], k]]
    for s in range(len(target.scene_starts) - 1):
        for begin in range(target.scene_starts[s], target.scene_starts[s + 1], _BLOCK):
            end = min(begin + _BLOCK, target.scene_starts[s + 1])
            for v in range(begin, end):
                block[:, v - begin] = targets[v]
            for i in range(first, last):
                u = nodes[i]
                if same and source.scene[u] == s:
                    continue
                slot = slot_of(scenes[i - first], costs[u], s)
                bound = costs[u, slot]
                block_costs(table, u, block, end - begin, nearby)
                for v in range(begin, end):
                    if nearby[v - begin] < bound:
                        cost = bounded_cost(table, u, targets, v, bound)
                        if cost < bound:
                            matches[u, slot], costs[u, slot], scenes[i - first, slot], bound = v, cost, s, cost


@njit(cache=True, nogil=True)
def search_to_nodes(
    index: PatchIndex,
    nodes: NDArray[np.int32],
    first: int,
    last: int,
    matches: NDArray[np.int32],
    costs: NDArray[np.float32],
) -> None:
    """Try edges from patches `first` to `last` to the selected nodes, the direction printed in the paper."""
    table, scene = index.table, index.scene
    scenes = np.empty(matches.shape[1], np.int32)
    for u in range(first, last):
        for k in range(len(scenes)):
            scenes[k] = scene[matches[u, k]]
        row, row_costs, own = matches[u], costs[u], scene[u]
        worst = largest(row_costs)
        for v in nodes:
            cost = bounded_cost(table, u, table, v, worst)
            if cost < worst and scene[v] != own:
                insert(v, cost, scene[v], row, row_costs, scenes)
                worst = largest(row_costs)
