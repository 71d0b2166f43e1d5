"""Clusters of similar descriptors, which initialise the search for matches.

The patches of an index are clustered around a few hundred centres. A patch is compared with the centres, then with the
patches of the nearest clusters only.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cell_grid import run_in_chunks
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import block_costs, bounded_cost
from mlsroad_pipeline.papers.luo2016.patch_graph.moves import insert, largest
from mlsroad_pipeline.papers.luo2016.patch_graph.patch_index import PatchIndex

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


@njit(cache=True, nogil=True)
def _means(table: NDArray[np.float32], cell: NDArray[np.int32], centres: NDArray[np.float32]) -> None:
    """Move each centre to the mean of its rows; centres without rows remain."""
    sums, counts = np.zeros(centres.shape), np.zeros(len(centres), np.int64)
    for i in range(len(table)):
        counts[cell[i]] += 1
        for k in range(table.shape[1]):
            sums[cell[i], k] += table[i, k]
    for c in range(len(centres)):
        if counts[c]:
            for k in range(table.shape[1]):
                centres[c, k] = sums[c, k] / counts[c]


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
