"""Graphs of points and objects: union-find, connected components, unique edges."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError


@njit(cache=True)
def find_root(parent: NDArray[np.int32], node: int) -> int:
    """Return the root of a node, with path halving."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True)
def join(parent: NDArray[np.int32], a: int, b: int) -> None:
    """Join the trees of two nodes. The smaller root remains root: the roots do not depend on the order of joins."""
    a = find_root(parent, a)
    b = find_root(parent, b)
    if a < b:
        parent[b] = a
    elif b < a:
        parent[a] = b


@njit(cache=True)
def _components(edges: NDArray[np.int64], n_nodes: int) -> NDArray[np.int32]:
    """Label connected components by union-find."""
    parent = np.arange(n_nodes).astype(np.int32)
    for e in range(len(edges)):
        join(parent, edges[e, 0], edges[e, 1])
    labels = np.empty(n_nodes, np.int32)
    n_labels = 0
    for node in range(n_nodes):
        root = find_root(parent, node)
        if root == node:  # the root is the first node of its component
            labels[node] = n_labels
            n_labels += 1
        else:
            labels[node] = labels[root]
    return labels


def check_edges(edges: ArrayLike, n_nodes: int) -> NDArray[np.int64]:
    """Return edges as a checked integer array."""
    array = np.asarray(edges)
    if array.size == 0:
        return np.zeros((0, 2), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 2 or not np.issubdtype(array.dtype, np.integer):
        raise DataError(f"edges must be integers of shape (e, 2), got {array.dtype} {array.shape}")
    low, high = int(array.min()), int(array.max())
    if low < 0 or high >= n_nodes:
        raise DataError(f"edges name node {low if low < 0 else high}, but there are {n_nodes} nodes")
    return np.ascontiguousarray(array, dtype=np.int64)


def connected_components(edges: ArrayLike, *, n_nodes: int) -> NDArray[np.int32]:
    """Label the connected components of an undirected graph.

    Examples
    --------
    >>> connected_components([[3, 1], [4, 0]], n_nodes=5).tolist()
    [0, 1, 2, 1, 0]
    """
    return _components(check_edges(edges, n_nodes), n_nodes)
