"""Searches over all patches: exhaustive (Luo et al. 2016, section III-B.2), and by clusters of similar descriptors."""

from collections.abc import Sequence
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import PatchIndex, block_costs, bounded_cost
from mlsroad_pipeline.papers.luo2016.patch_graph.moves import insert, largest, slot_of
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


_TURNS = 4
_SAMPLE = 32


class DescriptionCells(NamedTuple):
    """Patches of an index by clusters of similar descriptors."""

    centres: NDArray[np.float32]  # Mean weighted descriptor of each cell
    cell_starts: NDArray[np.int64]  # Start of each cell in `members`
    members: NDArray[np.int32]  # Patches, cell by cell, ascending within a cell


@njit(cache=True, nogil=True)
def _assign(
    table: NDArray[np.float32], centres: NDArray[np.float32], first: int, last: int, out: NDArray[np.int32]
) -> None:
    """Write the centre of lowest cost for rows `first` to `last`, the first of equal ones."""
    columns, costs = centres.T.copy(), np.empty(len(centres), np.float32)
    for i in range(first, last):
        block_costs(table, i, columns, len(centres), costs)
        out[i] = costs.argmin()


def _means(table: NDArray[np.float32], cell: NDArray[np.int32], centres: NDArray[np.float32]) -> None:
    """Move each centre to the mean of its rows; centres without rows remain."""
    counts = np.bincount(cell, minlength=len(centres))
    sums = np.stack([np.bincount(cell, column, len(centres)) for column in table.T], axis=1)
    centres[counts > 0] = sums[counts > 0] / counts[counts > 0, None]


def build_description_cells(table: NDArray[np.float32], *, seed: int = 0, n_threads: int = 1) -> DescriptionCells:
    """Cluster patches by k-means with the costs of matches, into about the square root of n cells."""
    n_cells = ceil(sqrt(len(table)))
    rows = np.random.default_rng(seed).permutation(len(table))[: _SAMPLE * n_cells]
    sample = table[rows]
    centres = sample[:n_cells].copy()
    for _ in range(_TURNS):
        _means(sample, _nearest(sample, centres, n_threads), centres)
    cell = _nearest(table, centres, n_threads)
    starts = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=n_cells))]).astype(np.int64)
    return DescriptionCells(centres, starts, np.argsort(cell, kind="stable").astype(np.int32))


def _nearest(table: NDArray[np.float32], centres: NDArray[np.float32], n_threads: int) -> NDArray[np.int32]:
    cell = np.empty(len(table), np.int32)
    run_in_chunks(lambda first, last: _assign(table, centres, first, last, cell), len(table), n_threads=n_threads)
    return cell


@njit(cache=True, nogil=True)
def _nearest_cells(
    table: NDArray[np.float32], centres: NDArray[np.float32], n_probes: int, first: int, last: int
) -> NDArray[np.int32]:
    """Return the cells of lowest centre cost for rows `first` to `last`, the cheapest first."""
    probes = np.empty((last - first, n_probes), np.int32)
    nearest, columns, costs = np.empty(n_probes, np.float32), centres.T.copy(), np.empty(len(centres), np.float32)
    for u in range(first, last):
        nearest[:] = np.inf
        row = probes[u - first]
        block_costs(table, u, columns, len(centres), costs)
        for c in range(len(centres)):
            if costs[c] < nearest[-1]:
                k = n_probes - 1
                while k > 0 and nearest[k - 1] > costs[c]:
                    nearest[k], row[k] = nearest[k - 1], row[k - 1]
                    k -= 1
                nearest[k], row[k] = costs[c], c
    return probes


@njit(cache=True, nogil=True)
def _rows_of_cells(probes: NDArray[np.int32], n_cells: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """List the rows that refer to each cell, as a CSR pair."""
    indptr = np.zeros(n_cells + 1, np.int64)
    for row in probes:
        for c in row:
            indptr[c + 1] += 1
    for c in range(n_cells):
        indptr[c + 1] += indptr[c]
    at, rows = indptr[:-1].copy(), np.empty(probes.size, np.int32)
    for i in range(len(probes)):
        for c in probes[i]:
            rows[at[c]] = i
            at[c] += 1
    return indptr, rows


@njit(cache=True, nogil=True)
def search_cells(
    source: PatchIndex,
    target: PatchIndex,
    cells: DescriptionCells,
    same: bool,
    n_probes: int,
    first: int,
    last: int,
    matches: NDArray[np.int32],
    costs: NDArray[np.float32],
) -> None:
    """Improve the matches of nodes `first` to `last` by the members of their nearest cells.

    The loop runs over cells, so that the members of a cell are loaded once for all nodes that are compared with them.
    The nearest cell of each node comes first: its matches avoid most later updates.
    """
    table, targets, target_scene = source.table, target.table, target.scene
    probes = _nearest_cells(table, cells.centres, min(n_probes, len(cells.centres)), first, last)
    scenes = np.empty((last - first, matches.shape[1]), np.int32)
    for u in range(first, last):
        for k in range(matches.shape[1]):
            scenes[u - first, k] = target_scene[matches[u, k]]
    n_most = np.diff(cells.cell_starts).max()
    block, nearby = np.empty((targets.shape[1], n_most), np.float32), np.empty(n_most, np.float32)
    hits = np.empty(n_most, np.int32)
    for part in (probes[:, :1], probes[:, 1:]):
        indptr, rows_of_cells = _rows_of_cells(part, len(cells.centres))
        for c in range(len(cells.centres)):
            if indptr[c] == indptr[c + 1]:
                continue
            members = cells.members[cells.cell_starts[c] : cells.cell_starts[c + 1]]
            for i in range(len(members)):
                block[:, i] = targets[members[i]]
            for near in rows_of_cells[indptr[c] : indptr[c + 1]]:
                u, row_scenes = first + near, scenes[near]
                row, row_costs = matches[u], costs[u]
                worst = largest(row_costs)
                block_costs(table, u, block, len(members), nearby)
                n_hits = 0
                for i in range(len(members)):
                    hits[n_hits] = members[i]
                    n_hits += nearby[i] < worst
                for v in hits[:n_hits]:
                    if not (same and target_scene[v] == source.scene[u]):
                        cost = bounded_cost(table, u, targets, v, worst)
                        if cost < worst:
                            insert(v, cost, target_scene[v], row, row_costs, row_scenes)
                            worst = largest(row_costs)
