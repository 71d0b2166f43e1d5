"""Multi-resolution octree: each point belongs to one node, each node holds a sample of its points."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_xyz

BITS = 21
"""Bits per axis of a Morton code."""

SPAN_BITS = 7
"""Bits per axis of the cells of a node: 128 cells, one sample point each."""

DEEPEST = BITS - SPAN_BITS


@dataclass(frozen=True)
class OctreeSample:
    """Points in the order of the nodes of an octree."""

    order: NDArray[np.int64]  # Point indices, node by node, in Morton order within a node
    keys: NDArray[np.int32]  # Depth, x, y and z of each node, parents first
    counts: NDArray[np.int64]  # Points of each node, at least 1
    low: NDArray[np.float64]  # Minimum corner of the root
    size: float  # Edge of the root


def sample_octree(xyz: NDArray[np.float64], *, largest: int = 50_000) -> OctreeSample:
    """Assign each point to a node of an octree.

    A node takes one point of each of its 128^3 cells and passes the others to its children. It takes all points if at
    most `largest` remain. All ancestors of a node thus hold points, as COPC 1.0 requires.
    """
    check_at_least(largest, 1, "largest")
    points = check_xyz(xyz)
    low = points.min(axis=0) if len(points) else np.zeros(3)
    extent = float((points.max(axis=0) - low).max()) if len(points) else 0.0
    size = max(extent, 1e-3) * (1.0 + 1e-9)
    codes = _morton(np.ascontiguousarray(points, dtype=np.float64), low.astype(np.float64), 2.0**BITS / size)
    rest = np.argsort(codes, kind="stable")
    codes = codes[rest]
    orders, keys, counts = [], [], []
    for depth in range(DEEPEST + 1):
        if not len(rest):
            break
        taken = _take(codes, np.uint64(3 * (BITS - depth)), largest, depth == DEEPEST)
        nodes = codes[taken] >> np.uint64(3 * (BITS - depth))
        starts = np.flatnonzero(np.diff(nodes, prepend=nodes[:1] + np.uint64(1)) != 0)
        orders.append(rest[taken])
        counts.append(np.diff(starts, append=len(nodes)))
        keys.append(_keys(nodes[starts], depth))
        rest, codes = rest[~taken], codes[~taken]
    if not orders:
        return OctreeSample(np.empty(0, np.int64), np.empty((0, 4), np.int32), np.empty(0, np.int64), low, size)
    return OctreeSample(np.concatenate(orders), np.concatenate(keys), np.concatenate(counts), low, size)


@njit(cache=True, nogil=True)
def _morton(xyz: NDArray[np.float64], low: NDArray[np.float64], cells: float) -> NDArray[np.uint64]:
    out = np.empty(len(xyz), dtype=np.uint64)
    last = np.uint64((1 << BITS) - 1)
    for i in range(len(xyz)):
        code = np.uint64(0)
        for axis in range(3):
            cell = min(np.uint64((xyz[i, axis] - low[axis]) * cells), last)
            for bit in range(BITS):
                code |= (cell >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
        out[i] = code
    return out


@njit(cache=True, nogil=True)
def _take(codes: NDArray[np.uint64], shift: np.uint64, largest: int, everything: bool) -> NDArray[np.bool_]:
    """Mark the points taken by the nodes of a depth: all of small nodes, the first of each cell of large ones."""
    taken = np.zeros(len(codes), dtype=np.bool_)
    begin = 0
    while begin < len(codes):
        node = codes[begin] >> shift
        end = begin + 1
        while end < len(codes) and codes[end] >> shift == node:
            end += 1
        whole = everything or end - begin <= largest
        cell_shift = shift - np.uint64(3 * SPAN_BITS) if not whole else np.uint64(0)
        for i in range(begin, end):
            taken[i] = whole or i == begin or codes[i] >> cell_shift != codes[i - 1] >> cell_shift
        begin = end
    return taken


def _keys(nodes: NDArray[np.uint64], depth: int) -> NDArray[np.int32]:
    keys = np.zeros((len(nodes), 4), dtype=np.int32)
    keys[:, 0] = depth
    for bit in range(depth):
        for axis in range(3):
            keys[:, axis + 1] |= ((nodes >> np.uint64(3 * bit + axis)) & np.uint64(1)).astype(np.int32) << bit
    return keys
