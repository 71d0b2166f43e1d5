"""Exact minimisation of submodular energies of binary variables by persistency and minimum cut.

The energy is ``sum_i gain_i x_i + sum_e slack_e |x_i - x_j|`` with slacks of at least 0. Every submodular pairwise
energy has this form (Kolmogorov and Zabih 2004, Theorem 4.1). A variable whose gain outweighs the slacks of all its
edges has the same value in every minimum (Hammer, Hansen and Simeone 1984). It is fixed, and its edges become gains of
their other ends, which may then be fixed as well. In labelling problems a few per cent of the variables remain for the
cut.
"""

import maxflow
import numpy as np
from numba import njit
from numpy.typing import NDArray

_FREE = -1
_FEW = 2000  # nodes that fit the cache in any order
_FAR = 0.05  # of all nodes between the ends of a mean edge


@njit(cache=True, nogil=True)
def _incidence(edges: NDArray[np.int32], n_nodes: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return row starts and (2 e, 2) pairs of neighbour and edge of each node."""
    start = np.zeros(n_nodes + 1, np.int64)
    for e in range(len(edges)):
        start[edges[e, 0] + 1] += 1
        start[edges[e, 1] + 1] += 1
    for i in range(n_nodes):
        start[i + 1] += start[i]
    at = start[:-1].copy()
    incident = np.empty((2 * len(edges), 2), np.int32)
    for e in range(len(edges)):
        for side in range(2):
            i = edges[e, side]
            incident[at[i], 0], incident[at[i], 1] = edges[e, 1 - side], e
            at[i] += 1
    return start, incident


@njit(cache=True, nogil=True)
def _breadth_first(start: NDArray[np.int64], incident: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the number of each node in a breadth-first search, so that neighbours are near each other in memory."""
    n_nodes = len(start) - 1
    number, queue = np.full(n_nodes, -1, np.int32), np.empty(n_nodes, np.int32)
    head, tail = 0, 0
    for first in range(n_nodes):
        if number[first] >= 0:
            continue
        queue[tail], number[first] = first, tail
        tail += 1
        while head < tail:
            i = queue[head]
            head += 1
            for at in range(start[i], start[i + 1]):
                j = incident[at, 0]
                if number[j] < 0:
                    queue[tail], number[j] = j, tail
                    tail += 1
    return number


def near_numbers(edges: NDArray[np.int32], n_nodes: int) -> NDArray[np.int32] | None:
    """Return new numbers of nodes whose neighbours are far away in memory, or None if they are near already.

    Moves over nodes in random order take up to three times as long, since most accesses miss the cache.
    """
    if len(edges) == 0 or n_nodes < _FEW or np.abs(edges[:, 0] - edges[:, 1]).mean() < n_nodes * _FAR:
        return None
    return np.asarray(_breadth_first(*_incidence(edges, n_nodes)))


@njit(cache=True, nogil=True)
def _fix_alone(
    bound: NDArray[np.float64],
    slack: NDArray[np.float64],
    value: NDArray[np.int8],
    start: NDArray[np.int64],
    incident: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Fix the variables whose own bounds suffice, and move their edges into the bounds of the others; return these.

    Most variables are fixed here. A free one takes over the edges to all of them at once.
    """
    free, n_free = np.empty(len(value), np.int32), 0
    for i in range(len(value)):
        if value[i] == _FREE:
            if bound[i, 0] >= 0 or bound[i, 1] < 0:
                value[i] = bound[i, 1] < 0
            else:
                free[n_free] = i
                n_free += 1
    free = free[:n_free]
    for node in free:
        i = int(node)
        for at in range(start[i], start[i + 1]):
            j = incident[at, 0]
            if value[j] == 1:
                bound[i, 1] -= 2.0 * slack[incident[at, 1]]
            elif value[j] == 0:
                bound[i, 0] += 2.0 * slack[incident[at, 1]]
    return free


@njit(cache=True, nogil=True)
def _fix(
    gain: NDArray[np.float64],
    slack: NDArray[np.float64],
    value: NDArray[np.int8],
    edges: NDArray[np.int32],
    start: NDArray[np.int64],
    incident: NDArray[np.int32],
) -> None:
    """Fix the variables with one value in every minimum, ties to 0; move their edges into the gains of free nodes.

    Nodes with a value are excluded: they have no edges with a slack.
    """
    n_nodes = len(gain)
    bound = np.empty((n_nodes, 2))  # cost of value 1 if all free neighbours are 1, and if all are 0
    bound[:, 0], bound[:, 1] = gain, gain
    for e in range(len(edges)):
        i, j, s = edges[e, 0], edges[e, 1], slack[e]
        bound[i, 0] -= s
        bound[i, 1] += s
        bound[j, 0] -= s
        bound[j, 1] += s
    free = _fix_alone(bound, slack, value, start, incident)
    stack = np.empty(len(free), np.int32)
    for first in free:
        if value[first] != _FREE or not (bound[first, 0] >= 0 or bound[first, 1] < 0):
            continue
        value[first] = bound[first, 1] < 0
        stack[0], top = first, 1
        while top > 0:
            top -= 1
            i = stack[top]
            side, sign = (1, -2.0) if value[i] == 1 else (0, 2.0)
            for at in range(start[i], start[i + 1]):
                j = incident[at, 0]
                if value[j] == _FREE:
                    bound[j, side] += sign * slack[incident[at, 1]]
                    if bound[j, 0] >= 0 or bound[j, 1] < 0:
                        value[j] = bound[j, 1] < 0
                        stack[top] = j
                        top += 1
    for i in free:
        gain[i] = 0.5 * (bound[i, 0] + bound[i, 1])


@njit(cache=True, nogil=True)
def _free_part(
    gain: NDArray[np.float64],
    slack: NDArray[np.float64],
    value: NDArray[np.int8],
    start: NDArray[np.int64],
    incident: NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the free nodes, their gains, and the ends (as indices of free nodes) and slacks of their edges."""
    number = np.full(len(value), -1, np.int64)
    nodes = np.flatnonzero(value == _FREE)
    number[nodes] = np.arange(len(nodes))
    n_edges = 0
    for i in nodes:
        n_edges += start[i + 1] - start[i]
    first, second, weight = np.empty(n_edges, np.int64), np.empty(n_edges, np.int64), np.empty(n_edges)
    n_edges = 0
    for i in nodes:
        for at in range(start[i], start[i + 1]):
            j, e = incident[at, 0], incident[at, 1]
            if j > i and number[j] >= 0 and slack[e] > 0:
                first[n_edges], second[n_edges], weight[n_edges] = number[i], number[j], slack[e]
                n_edges += 1
    return nodes, gain[nodes], first[:n_edges], second[:n_edges], weight[:n_edges]


class CutGraph:
    """Graph for repeated minimisation of binary energies with changing terms."""

    def __init__(self, edges: NDArray[np.int32], n_nodes: int) -> None:
        self.edges = np.ascontiguousarray(edges, dtype=np.int32)
        self.n_nodes = n_nodes
        self._start, self._incident = _incidence(self.edges, n_nodes)

    def minimize(
        self, gain: NDArray[np.float64], slack: NDArray[np.float64], fixed: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Return the minimum of ``sum_i gain_i x_i + sum_e slack_e |x_i - x_j|``."""
        value = np.where(fixed, 0, _FREE).astype(np.int8)
        _fix(gain, slack, value, self.edges, self._start, self._incident)
        nodes, tied, first, second, weight = _free_part(gain, slack, value, self._start, self._incident)
        value[nodes] = _cut(tied, first, second, weight)
        return value == 1


def _cut(
    gain: NDArray[np.float64], first: NDArray[np.int64], second: NDArray[np.int64], weight: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Solve the free part by maximum flow; nodes on the sink side take 1."""
    if len(gain) == 0:
        return np.zeros(0, dtype=np.bool_)
    graph = maxflow.Graph[float](len(gain), len(first))
    nodes = np.arange(len(gain))
    graph.add_nodes(len(gain))
    graph.add_edges(first, second, weight, weight)
    graph.add_grid_tedges(nodes, np.maximum(gain, 0.0), np.maximum(-gain, 0.0))
    graph.maxflow()
    return np.asarray(graph.get_grid_segments(nodes), dtype=np.bool_)
