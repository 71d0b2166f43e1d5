"""Search moves as compiled kernels (Luo et al. 2016, section III-B.2).

A node reads the graph of the last iteration and writes only its own row of the next one. The result therefore depends
neither on the number of threads nor on the order of the nodes. Nodes are rows of a `PatchIndex`. In training, matches
start and end in the same index; in transfer, they start in the unlabelled scene.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.papers.luo2016.patch_graph.costs import PatchIndex, bounded_cost

_SEEN = 2048  # entries of the filter of repeated candidates, a power of two


@njit(cache=True, nogil=True)
def random_below(seed: int, stream: int, draw: int, n: int) -> int:
    """Return a pseudo-random number from 0 to n - 1, a function of the arguments alone (counter-based SplitMix64)."""
    x = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(stream)
    for step in range(2):
        x = x * np.uint64(0xD1342543DE82EF95) + np.uint64(draw + step) * np.uint64(0x9E3779B97F4A7C15)
        x ^= x >> np.uint64(30)
        x *= np.uint64(0xBF58476D1CE4E5B9)
        x ^= x >> np.uint64(27)
        x *= np.uint64(0x94D049BB133111EB)
        x ^= x >> np.uint64(31)
    return int((x >> np.uint64(33)) % np.uint64(n))


@njit(cache=True, nogil=True)
def slot_of(scenes: NDArray, costs: NDArray, scene: int) -> int:
    """Return the match that a candidate from `scene` would replace (algorithm 1, line 1)."""
    worst = 0
    for k in range(len(scenes)):
        if scenes[k] == scene:
            return k
        if costs[k] > costs[worst]:
            worst = k
    return worst


@njit(cache=True, nogil=True)
def largest(costs: NDArray[np.float32]) -> np.float32:
    """Return the largest cost of a row, the upper bound for candidates."""
    worst = costs[0]
    for k in range(1, len(costs)):
        worst = max(worst, costs[k])
    return worst


@njit(cache=True, nogil=True)
def insert(v: int, cost: float, scene: int, matches: NDArray, costs: NDArray, scenes: NDArray) -> None:
    """Update a row with a candidate match (algorithm 1)."""
    slot = slot_of(scenes, costs, scene)
    if cost < costs[slot]:
        matches[slot], costs[slot], scenes[slot] = v, cost, scene


@njit(cache=True, nogil=True)
def best_in_ball(
    table: NDArray[np.float32],
    u: int,
    targets: NDArray[np.float32],
    xyz: NDArray[np.float32],
    v: int,
    rows: NDArray[np.int32],
    squared: np.float32,
    bound: np.float32,
    seen: NDArray[np.int32],
) -> tuple[int, np.float32]:
    """Return the cheapest match of u among the patches around v, with its cost; -1 if none is below `bound`."""
    best = -1
    x, y, z = xyz[v, 0], xyz[v, 1], xyz[v, 2]
    for j in range(len(rows)):
        for w in range(rows[j, 0], rows[j, 1]):
            dx, dy, dz = xyz[w, 0] - x, xyz[w, 1] - y, xyz[w, 2] - z
            if dx * dx + dy * dy + dz * dz > squared or seen[w & (_SEEN - 1)] == w:
                continue
            seen[w & (_SEEN - 1)] = w
            cost = bounded_cost(table, u, targets, w, bound)
            if cost < bound:
                best, bound = w, cost
    return best, bound


@njit(cache=True, nogil=True)
def _random_of_height(target: PatchIndex, scene: int, height: float, tolerance: float, draw: int) -> int:
    """Return a random patch of a scene of about the same height, or else the patch of nearest height."""
    first, last = target.scene_starts[scene], target.scene_starts[scene + 1]
    heights = target.heights[first:last]
    low = np.searchsorted(heights, height - tolerance)
    high = np.searchsorted(heights, height + tolerance, side="right")
    if low == high:  # no patch of this height: take the nearest below or above
        if low == len(heights) or (low > 0 and height - heights[low - 1] <= heights[low] - height):
            low -= 1
        high = low + 1
    return target.by_height[first + low + draw % (high - low)]


@njit(cache=True, nogil=True)
def initialise(
    source: PatchIndex,
    heights: NDArray[np.float32],
    target: PatchIndex,
    same: bool,
    tolerance: float,
    seed: int,
    first: int,
    last: int,
    matches: NDArray[np.int32],
    costs: NDArray[np.float32],
) -> None:
    """Initialise nodes with the best of K random matches from different scenes and K of about the same height."""
    n_scenes = len(target.scene_starts) - 1
    n_matches = matches.shape[1]
    pool = np.empty(n_scenes, np.int64)
    scenes = np.empty(n_matches, np.int32)
    for u in range(first, last):
        scenes[:] = -1
        costs[u] = np.inf
        for by_height in range(2):
            n_pool = 0
            for s in range(n_scenes):
                if not (same and source.scene[u] == s):
                    pool[n_pool] = s
                    n_pool += 1
            for k in range(n_matches):
                draw = 2 * (by_height * n_matches + k)
                j = k + random_below(seed, u, draw, n_pool - k)
                pool[k], pool[j] = pool[j], pool[k]
                s = pool[k]
                begin, n_patches = target.scene_starts[s], target.scene_starts[s + 1] - target.scene_starts[s]
                if by_height == 0:
                    v = begin + random_below(seed, u, draw + 1, n_patches)
                else:
                    v = _random_of_height(
                        target, s, heights[u], tolerance, random_below(seed, u, draw + 1, n_patches * 1024)
                    )
                cost = bounded_cost(source.table, u, target.table, v, np.float32(np.inf))
                insert(v, cost, s, matches[u], costs[u], scenes)


def incoming_edges(matches: NDArray[np.int32], fresh: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """List the sources of the fresh incoming edges of each node, as a CSR pair."""
    sources, _ = np.nonzero(fresh)
    targets = matches[fresh]
    indptr = np.concatenate([[0], np.cumsum(np.bincount(targets, minlength=len(matches)))])
    return indptr, sources[np.argsort(targets, kind="stable")].astype(np.int32)


@njit(cache=True, nogil=True)
def _start_row(
    target: PatchIndex, matches: NDArray, costs: NDArray, u: int, row: NDArray, row_costs: NDArray, scenes: NDArray
) -> None:
    for k in range(matches.shape[1]):
        row[k], row_costs[k], scenes[k] = matches[u, k], costs[u, k], target.scene[matches[u, k]]


@njit(cache=True, nogil=True)
def enrich_and_search(
    source: PatchIndex,
    target: PatchIndex,
    same: bool,
    graph: NDArray[np.int32],
    graph_fresh: NDArray[np.bool_],
    incoming_indptr: NDArray[np.int64],
    incoming: NDArray[np.int32],
    matches: NDArray[np.int32],
    costs: NDArray[np.float32],
    fresh: NDArray[np.bool_],
    radius: float,
    first: int,
    last: int,
    new_matches: NDArray[np.int32],
    new_costs: NDArray[np.float32],
) -> None:
    """Improve the matches of nodes `first` to `last` by inverse and forward enrichment and by local search.

    Only `fresh` edges yield candidates. Forward enrichment follows `graph`: the nodes' own matches in training, the
    matches of the trained graph in transfer.
    """
    table, targets, xyz, target_scene = source.table, target.table, target.xyz, target.scene
    squared = np.float32(radius) * np.float32(radius)
    n_matches = matches.shape[1]
    scenes = np.empty(n_matches, np.int32)
    seen = np.empty(_SEEN, np.int32)
    for u in range(first, last):
        row, row_costs = new_matches[u], new_costs[u]
        _start_row(target, matches, costs, u, row, row_costs, scenes)
        worst = largest(row_costs)
        for i in range(incoming_indptr[u], incoming_indptr[u + 1]):
            w = incoming[i]
            cost = bounded_cost(table, u, targets, w, worst)
            if cost < worst:
                insert(w, cost, target_scene[w], row, row_costs, scenes)
                worst = largest(row_costs)
        for k in range(n_matches):
            v = matches[u, k]
            for j in range(n_matches):
                w = graph[v, j]
                if not (fresh[u, k] or graph_fresh[v, j]) or (same and target_scene[w] == source.scene[u]):
                    continue
                cost = bounded_cost(table, u, targets, w, worst)
                if cost < worst:
                    insert(w, cost, target_scene[w], row, row_costs, scenes)
                    worst = largest(row_costs)
        seen[:] = -1
        for k in range(n_matches):
            if fresh[u, k]:
                v = matches[u, k]
                bound = row_costs[slot_of(scenes, row_costs, target_scene[v])]
                w, cost = best_in_ball(table, u, targets, xyz, v, target.far[target.cell[v]], squared, bound, seen)
                if w >= 0:
                    insert(w, cost, target_scene[w], row, row_costs, scenes)


@njit(cache=True, nogil=True)
def propagate(
    source: PatchIndex,
    target: PatchIndex,
    matches: NDArray[np.int32],
    costs: NDArray[np.float32],
    fresh: NDArray[np.bool_],
    radius: float,
    factor: np.float32,
    first: int,
    last: int,
    new_matches: NDArray[np.int32],
    new_costs: NDArray[np.float32],
) -> None:
    """Improve the matches of nodes `first` to `last` by patches around the `fresh` matches of their neighbours.

    A neighbourhood is searched only if its centre costs less than `factor` times the match to replace.
    """
    table, targets, xyz, target_scene, places = source.table, target.table, target.xyz, target.scene, source.xyz
    squared = np.float32(radius) * np.float32(radius)
    n_matches = matches.shape[1]
    scenes = np.empty(n_matches, np.int32)
    seen = np.empty(_SEEN, np.int32)
    seen_centre = np.empty(_SEEN, np.int32)
    for u in range(first, last):
        row, row_costs = new_matches[u], new_costs[u]
        _start_row(target, matches, costs, u, row, row_costs, scenes)
        seen[:] = -1
        seen_centre[:] = -1
        rows = source.near[source.cell[u]]
        for j in range(len(rows)):
            for w in range(rows[j, 0], rows[j, 1]):
                dx, dy, dz = places[w, 0] - places[u, 0], places[w, 1] - places[u, 1], places[w, 2] - places[u, 2]
                if w == u or dx * dx + dy * dy + dz * dz > squared:
                    continue
                for k in range(n_matches):
                    v = matches[w, k]
                    if not fresh[w, k] or seen_centre[v & (_SEEN - 1)] == v:
                        continue
                    seen_centre[v & (_SEEN - 1)] = v
                    bound = row_costs[slot_of(scenes, row_costs, target_scene[v])]
                    limit = factor * bound
                    if bounded_cost(table, u, targets, v, limit) >= limit:
                        continue
                    t, cost = best_in_ball(table, u, targets, xyz, v, target.near[target.cell[v]], squared, bound, seen)
                    if t >= 0:
                        insert(t, cost, target_scene[t], row, row_costs, scenes)


def mark_changes(old: NDArray[np.int32], new: NDArray[np.int32], fresh: NDArray[np.bool_], keep: bool) -> None:
    """Mark matches absent from `old`; with `keep`, also those marked before and still present."""
    same = new[:, :, None] == old[:, None, :]
    fresh[:] = ~same.any(axis=2) | (keep & (same & fresh[:, None, :]).any(axis=2))
