"""A tree over the words of a vocabulary, and the search of it for the nearest word."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.visual_words._context import Context, context_factor, feature_distance, likeness

LEAF = 12
"""The most words of a leaf."""

BOX = 16
"""Directions that boxes are bounded in; the rest of a distance is looked at word by word."""

_SLACK = 1.0 - 1e-9  # bounds are rounded, too


class Tree(NamedTuple):
    """Boxes around ever smaller sets of words.

    Parameters
    ----------
    order : ndarray of int64, shape (v,)
        Words in the order of the leaves.
    words : ndarray of int64, shape (t, 2)
        First and past-the-last place of each node's words in `order`.
    children : ndarray of int64, shape (t, 2)
        Children of each node, -1 for leaves.
    low, high : ndarray of float64, shape (t, b + 2)
        Each node's box in the first directions of the places, in the angle and in the ratios.
    """

    order: NDArray[np.int64]
    words: NDArray[np.int64]
    children: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def build_tree(places: NDArray[np.float64], words: Context) -> Tree:
    """Build the tree: halves across the widest direction, until a leaf's words are left.

    Parameters
    ----------
    places : ndarray of float64, shape (v, d)
        Where the words lie, directions of large variance first.
    words : Context
        Their angles and ratios.

    Returns
    -------
    Tree
        The tree; the root is node 0.
    """
    box = places[:, :BOX]
    # The context is a factor: halving the angle's range helps about as much as halving the widest direction does.
    weight = float(box[:, 0].std()) / max(float(words.angle.std()), 1e-12)
    lowest = np.column_stack([box, words.angle, words.ratio.min(axis=1)])
    highest = np.column_stack([box, words.angle, words.ratio.max(axis=1)])
    splits = np.column_stack([box, words.angle * weight])
    order = np.arange(len(places))
    ranges, children, low, high = [(0, len(order))], [[-1, -1]], [], []
    node = 0
    while node < len(ranges):
        first, stop = ranges[node]
        mine = order[first:stop]
        low.append(lowest[mine].min(axis=0))
        high.append(highest[mine].max(axis=0))
        if stop - first > LEAF:
            rows = splits[mine]
            axis = int(np.argmax(rows.var(axis=0)))
            half = (stop - first) // 2
            order[first:stop] = mine[np.argpartition(rows[:, axis], half)]
            children[node] = [len(ranges), len(ranges) + 1]
            ranges += [(first, first + half), (first + half, stop)]
            children += [[-1, -1], [-1, -1]]
        node += 1
    return Tree(order, np.array(ranges), np.array(children), np.array(low), np.array(high))


@njit(cache=True, nogil=True)
def _closest(value: float, low: float, high: float) -> float:
    """Return the largest likeness of a value with anything in a range."""
    if low <= value <= high:
        return 1.0
    return likeness(value, low if value < low else high)


@njit(cache=True, nogil=True)
def _bound(
    place: NDArray[np.float64], angle: float, ratio: float, low: NDArray[np.float64], high: NDArray[np.float64],
    grouped: bool, floor: float,
) -> float:  # fmt: skip
    """Return a distance that no word of a node is nearer than."""
    width = len(low) - 2
    away = 0.0
    for c in range(width):
        off = max(low[c] - place[c], place[c] - high[c], 0.0)
        away += off * off
    if not grouped:
        return away * _SLACK
    like = _closest(angle, low[width], high[width]) + _closest(ratio, low[width + 1], high[width + 1])
    return max(1.0 - 0.5 * like, floor) * away * _SLACK


@njit(cache=True, nogil=True)
def search(
    wanted: Context,
    places: NDArray[np.float64],
    words: Context,
    word_places: NDArray[np.float64],
    tree: Tree,
    matching: NDArray[np.int64],
    floor: float,
    first: int,
    stop: int,
    out: NDArray[np.int32],
    distances: NDArray[np.float64],
) -> None:
    """Find the nearest word of each group from `first` to `stop`.

    Parameters
    ----------
    wanted : Context
        The groups.
    places : ndarray of float64, shape (n, d)
        Where they lie.
    words : Context
        The words, in the order of the tree's leaves.
    word_places : ndarray of float64, shape (v, d)
        Where those lie.
    tree : Tree
        The tree.
    matching : ndarray of int64, shape (p, m)
        The matching orders.
    floor : float
        Least context factor.
    first, stop : int
        Which groups.
    out : ndarray of int32, shape (n,)
        Output: the nearest words.
    distances : ndarray of float64, shape (n,)
        Output: their distances.
    """
    depth = 2 * int(np.ceil(np.log2(len(tree.order) + 1))) + 4
    nodes, bounds = np.empty(depth, np.int64), np.empty(depth)
    grouped = matching.shape[1] > 1
    for i in range(first, stop):
        place, angle, ratio = places[i], wanted.angle[i], wanted.ratio[i, 0]
        least, least_sum, word = np.inf, np.inf, np.int64(-1)
        nodes[0], bounds[0], top = 0, 0.0, 1
        while top > 0:
            top -= 1
            node = nodes[top]
            if bounds[top] > least:
                continue
            left, right = tree.children[node]
            if left >= 0:
                a = _bound(place, angle, ratio, tree.low[left], tree.high[left], grouped, floor)
                b = _bound(place, angle, ratio, tree.low[right], tree.high[right], grouped, floor)
                near, far, d_near, d_far = (left, right, a, b) if a <= b else (right, left, b, a)
                if d_far <= least:
                    nodes[top], bounds[top] = far, d_far
                    top += 1
                if d_near <= least:
                    nodes[top], bounds[top] = near, d_near
                    top += 1
                continue
            for j in range(tree.words[node, 0], tree.words[node, 1]):
                factor = context_factor(angle, ratio, words.angle[j], words.ratio[j], floor)
                limit = least / (factor * _SLACK) if factor > 0.0 else np.inf
                away = 0.0
                for c in range(len(place)):
                    away += (place[c] - word_places[j, c]) ** 2
                    if away > limit:
                        break
                if away > limit:
                    continue
                total = feature_distance(wanted.features[i], ratio, words.features[j], words.ratio[j], matching, limit)
                value = factor * total
                nearer = value < least or (value == least and total < least_sum)
                if nearer or (value == least and total == least_sum and tree.order[j] < word):
                    least, least_sum, word = value, total, tree.order[j]
        out[i], distances[i] = word, least
