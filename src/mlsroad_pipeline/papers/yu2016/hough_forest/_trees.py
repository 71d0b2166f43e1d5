"""Kernels of the Hough forest: growth of trees on classes and offsets, and voting."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

N_DIRECTIONS = 64
"""Largest number of directions of a circular vote."""

_ANGLES = np.arange(N_DIRECTIONS) * (2.0 * np.pi / N_DIRECTIONS)
_COSINES, _SINES = np.cos(_ANGLES), np.sin(_ANGLES)


@njit(cache=True, nogil=True)
def _class_impurity(
    values: NDArray, threshold: float, rows: NDArray, labels: NDArray, weights: NDArray, n_classes: int
) -> float:
    """Return the weighted Gini impurity of both sides; infinity where one is empty."""
    sums = np.zeros((2, n_classes))
    for i in range(len(rows)):
        sums[int(values[i] > threshold), labels[rows[i]]] += weights[rows[i]]
    result = 0.0
    for side in range(2):
        total = sums[side].sum()
        if total == 0.0:
            return np.inf
        result += total - (sums[side] ** 2).sum() / total
    return result


@njit(cache=True, nogil=True)
def _offset_impurity(
    values: NDArray, threshold: float, rows: NDArray, labels: NDArray, weights: NDArray, offsets: NDArray, n: int
) -> float:
    """Return the weighted squared deviations of the offsets from their mean per side and class, without background."""
    sums = np.zeros((2, n, 4))
    on_side = np.zeros(2)
    for i in range(len(rows)):
        row = rows[i]
        side, label, weight = int(values[i] > threshold), labels[row], weights[row]
        on_side[side] += 1.0
        if label == n - 1:
            continue
        sums[side, label, 0] += weight
        sums[side, label, 1] += weight * offsets[row, 0]
        sums[side, label, 2] += weight * offsets[row, 1]
        sums[side, label, 3] += weight * (offsets[row, 0] ** 2 + offsets[row, 1] ** 2)
    if on_side[0] == 0.0 or on_side[1] == 0.0:
        return np.inf
    result = 0.0
    for side in range(2):
        for label in range(n - 1):
            total = sums[side, label, 0]
            if total > 0.0:
                result += sums[side, label, 3] - (sums[side, label, 1] ** 2 + sums[side, label, 2] ** 2) / total
    return result


@njit(cache=True, nogil=True)
def _best_split(
    features: NDArray,
    labels: NDArray,
    offsets: NDArray,
    weights: NDArray,
    mine: NDArray,
    n_classes: int,
    n_tests: int,
    rng: np.random.Generator,
) -> tuple[int, np.float32]:
    """Return column and threshold of the best random split by class or, at random, by offset; column -1 for none."""
    best, best_feature, best_threshold = np.inf, -1, np.float32(0)
    by_class = rng.random() < 0.5
    values = np.empty(len(mine), np.float32)
    for _ in range(n_tests):
        column = int(rng.random() * features.shape[1])
        for i in range(len(mine)):
            values[i] = features[mine[i], column]
        one, other = values[int(rng.random() * len(mine))], values[int(rng.random() * len(mine))]
        if one == other:
            continue
        cut = np.float32(0.5) * (one + other)
        if by_class:
            impurity = _class_impurity(values, cut, mine, labels, weights, n_classes)
        else:
            impurity = _offset_impurity(values, cut, mine, labels, weights, offsets, n_classes)
        if impurity < best:
            best, best_feature, best_threshold = impurity, column, cut
    return best_feature, best_threshold


@njit(cache=True, nogil=True)
def _partition(order: NDArray, begin: int, end: int, values: NDArray, threshold: float) -> int:
    """Move rows at or below a threshold to the front; return the index of the first other row."""
    low, high = begin, end - 1
    while low <= high:
        if values[order[low]] <= threshold:
            low += 1
        else:
            order[low], order[high] = order[high], order[low]
            high -= 1
    return low


@njit(cache=True, nogil=True)
def grow_tree(
    features: NDArray[np.float32],
    labels: NDArray[np.int16],
    offsets: NDArray[np.float64],
    weights: NDArray[np.float64],
    rows: NDArray[np.int64],
    n_classes: int,
    max_depth: int,
    min_parts: int,
    n_tests: int,
    rng: np.random.Generator,
) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """Grow a tree; return feature (-1: leaf), threshold and left child of each node, leaf starts, and rows by leaf.

    The last class is the background. A leaf's `left` is its number.
    """
    most = 2 * len(rows) + 1
    feature, threshold = np.full(most, -1, np.int16), np.zeros(most, np.float32)
    left = np.zeros(most, np.int32)
    order = rows.copy()
    begin, end, depth = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.int64)
    end[0] = len(rows)
    n_nodes, node, n_leaves, filled = 1, 0, 0, 0
    starts, by_leaf = np.zeros(len(rows) + 2, np.int64), np.empty(len(rows), np.int64)
    while node < n_nodes:
        mine = order[begin[node] : end[node]]
        column, cut = -1, np.float32(0)
        if depth[node] < max_depth and len(mine) >= 2 * min_parts:
            column, cut = _best_split(features, labels, offsets, weights, mine, n_classes, n_tests, rng)
        if column >= 0:
            middle = _partition(order, begin[node], end[node], features[:, column], cut)
            if middle - begin[node] < min_parts or end[node] - middle < min_parts:
                column = -1
        if column >= 0:
            feature[node], threshold[node], left[node] = column, cut, n_nodes
            begin[n_nodes], end[n_nodes] = begin[node], middle
            begin[n_nodes + 1], end[n_nodes + 1] = middle, end[node]
            depth[n_nodes], depth[n_nodes + 1] = depth[node] + 1, depth[node] + 1
            n_nodes += 2
        else:
            left[node] = n_leaves
            by_leaf[filled : filled + len(mine)] = mine
            filled += len(mine)
            n_leaves += 1
            starts[n_leaves] = filled
        node += 1
    return feature[:n_nodes], threshold[:n_nodes], left[:n_nodes], starts[: n_leaves + 1], by_leaf


@njit(cache=True, nogil=True)
def _blur(space: NDArray[np.float64], stride: int, length: int) -> None:
    """Blur a flat vote space along one axis by the kernel (1, 2, 1) / 4, with zeros beyond its ends."""
    for start in range(len(space)):
        if start // stride % length:
            continue
        before = 0.0
        for k in range(length):
            at = start + k * stride
            here = space[at]
            after = space[at + stride] if k + 1 < length else 0.0
            space[at] = 0.25 * before + 0.5 * here + 0.25 * after
            before = here


@njit(cache=True, nogil=True)
def _cast(
    space: NDArray, shape: NDArray, x: float, y: float, k: int, radius: float, weight: float, cell: float
) -> None:
    """Spread a vote over the circle of possible centres; x and y are relative to the corner of the space."""
    step = N_DIRECTIONS
    while step > 1 and N_DIRECTIONS // step < 2.0 * np.pi * radius / cell:
        step //= 2
    share = weight * step / N_DIRECTIONS
    for a in range(0, N_DIRECTIONS, step):
        cx, cy = x + radius * _COSINES[a], y + radius * _SINES[a]
        if cx >= 0.0 and cy >= 0.0:
            i, j = int(cx / cell), int(cy / cell)
            if i < shape[0] and j < shape[1]:
                space[(k * shape[1] + j) * shape[0] + i] += share


@njit(cache=True, nogil=True)
def _leaf_of(row: NDArray, root: int, feature: NDArray, threshold: NDArray, left: NDArray) -> int:
    """Return the leaf of a part in a tree."""
    node = root
    while feature[node] >= 0:
        node = root + left[node] + int(row[feature[node]] > threshold[node])
    return left[node]


@njit(cache=True, nogil=True)
def _extent(
    centres: NDArray, first: int, last: int, cell: float, height_cell: float, corner: NDArray, shape: NDArray
) -> None:
    """Write the corner and the shape of an object's vote space, with a margin for the blur."""
    for axis in range(3):
        low, high = np.inf, -np.inf
        for p in range(first, last):
            low, high = min(low, centres[p, axis]), max(high, centres[p, axis])
        size, margin = (height_cell, 1) if axis == 2 else (cell, 2)
        corner[axis] = low - (margin + 0.5) * size
        shape[axis] = int((high - low) / size) + 2 * margin + 2


@njit(cache=True, nogil=True)
def vote(
    features: NDArray[np.float32],
    centres: NDArray[np.float64],
    bounds: NDArray[np.int64],
    selected: NDArray[np.bool_],
    roots: NDArray[np.int64],
    feature: NDArray[np.int16],
    threshold: NDArray[np.float32],
    left: NDArray[np.int32],
    leaf_roots: NDArray[np.int64],
    shares: NDArray[np.float32],
    vote_starts: NDArray[np.int64],
    votes: NDArray[np.float32],
    cell: float,
    height_cell: float,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write the highest peak of each object's vote space for each class, over its `selected` trees."""
    n_classes = out.shape[1]
    corner, shape = np.zeros(3), np.zeros(3, np.int64)
    for o in range(start, stop):
        first, last = bounds[o], bounds[o + 1]
        used = np.flatnonzero(selected[:, o])
        if first == last or len(used) == 0:
            continue
        _extent(centres, first, last, cell, height_cell, corner, shape)
        leaves = np.empty((last - first, len(used)), np.int64)
        for p in range(last - first):
            for t in range(len(used)):
                leaf = _leaf_of(features[first + p], roots[used[t]], feature, threshold, left)
                leaves[p, t] = leaf_roots[used[t]] + leaf
        space = np.empty(shape[0] * shape[1] * shape[2])
        for c in range(n_classes):
            space[:] = 0.0
            for p in range(last - first):
                x, y = centres[first + p, 0] - corner[0], centres[first + p, 1] - corner[1]
                z = centres[first + p, 2] - corner[2]
                for t in range(len(used)):
                    at = leaves[p, t] * n_classes + c
                    begin, end = vote_starts[at], vote_starts[at + 1]
                    for v in range(begin, end):
                        k = int(np.floor((z + votes[v, 1]) / height_cell))
                        if 0 <= k < shape[2]:
                            weight = shares[leaves[p, t], c] / ((end - begin) * len(used))
                            _cast(space, shape, x, y, k, votes[v, 0], weight, cell)
            _blur(space, 1, shape[0])
            _blur(space, shape[0], shape[1])
            _blur(space, shape[0] * shape[1], shape[2])
            out[o, c] = space.max()
