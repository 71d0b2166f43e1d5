"""Cells of words, and the search for the nearest word.

Whitened features have no direction of small variance, so a search tree visits most of its nodes. Instead, the cost per
word is kept small. Words are stored in cells of a few dozen, direction by direction, so that the first directions of a
distance are summed for a whole cell in vector registers. Cells whose box is too far away are skipped, and only words
with a small enough partial sum are compared in full.
"""

from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class Context(NamedTuple):
    """Groups prepared for the distance."""

    # Whitened descriptors: the Mahalanobis distance of two features is the squared distance of two rows
    features: NDArray[np.float64]
    angle: NDArray[np.float64]  # ORel, equation 12, radians
    ratio: NDArray[np.float64]  # SRel, equation 13, in each matching order of `orders`


def orders(m: int) -> NDArray[np.int64]:
    """Return all matching orders of m features, (m!, m), the identity first."""
    return np.array(list(permutations(range(m))), dtype=np.int64)


def prepare(descriptors: NDArray, orientations: NDArray, scales: NDArray, whitening: NDArray[np.float64]) -> Context:
    """Prepare groups for the distance."""
    g, m = scales.shape
    features = descriptors.astype(np.float64) @ whitening
    axes, sizes = orientations.astype(np.float64), scales.astype(np.float64)
    angle, ratio = np.zeros(g), np.zeros((g, len(orders(m))))
    for x, y in combinations(range(m), 2):
        # Eigenvectors have no sign: the acute angle.
        angle += np.arccos(np.minimum(np.abs((axes[:, x] * axes[:, y]).sum(axis=1)), 1.0))
    for p, order in enumerate(orders(m)):
        for x, y in combinations(range(m), 2):
            ratio[:, p] += np.log1p(sizes[:, order[x]] / sizes[:, order[y]])
    return Context(np.ascontiguousarray(features), angle, ratio)


def sorted_features(context: Context) -> NDArray[np.float64]:
    """Return the features of each group with every coordinate sorted separately, (g, m * r).

    Of all pairings of two sets of numbers, the sorted one has the least sum of squared differences. The distance of
    these rows is therefore a lower bound of the distance of two groups in any matching order.
    """
    g, m, r = context.features.shape
    return np.sort(context.features, axis=1).reshape(g, m * r)


@njit(cache=True, nogil=True)
def ratio_similarity(a: float, b: float) -> float:
    """Return the ratio of minimum and maximum of two non-negative numbers (equations 14 and 15); 1 where both are 0."""
    low, high = min(a, b), max(a, b)
    return low / high if high > 0.0 else 1.0


@njit(cache=True, nogil=True)
def context_factor(angle: float, ratio: float, other_angle: float, other: NDArray[np.float64], floor: float) -> float:
    """Return 1 - SCSim of equation 11 under the best matching order, at least `floor`; 1 for groups of one region."""
    if len(other) == 1:
        return 1.0
    best = 0.0
    for p in range(len(other)):
        best = max(best, ratio_similarity(ratio, other[p]))
    return max(1.0 - 0.5 * (ratio_similarity(angle, other_angle) + best), floor)


@njit(cache=True, nogil=True)
def feature_distance(
    features: NDArray[np.float64], ratio: float, others: NDArray[np.float64], ratios: NDArray[np.float64],
    matching: NDArray[np.int64], limit: float,
) -> float:  # fmt: skip
    """Return the sum of equation 16 for the best matching order; the least sum of equally good orders."""
    best = 0.0
    for p in range(len(ratios)):
        best = max(best, ratio_similarity(ratio, ratios[p]))
    least = np.inf
    for p in range(len(ratios)):
        if ratio_similarity(ratio, ratios[p]) < best * (1.0 - 1e-12):
            continue
        total = 0.0
        for x in range(len(features)):
            row, other = features[x], others[matching[p, x]]
            for c in range(len(row)):
                total += (row[c] - other[c]) ** 2
            if total > limit and total > least:
                break
        least = min(least, total)
    return least


CELL = 64
"""Largest number of words in a cell."""

DIRECTIONS = 16
"""Number of directions of the partial sums, those of the largest variance."""

_FIRST = 3  # cells searched first, the nearest by their bounds
_SLACK = np.float32(1.0 - 1e-4)  # margin for bounds summed in single precision


class Cells(NamedTuple):
    """Words by cell."""

    order: NDArray[np.int64]  # Words in the order of the cells
    starts: NDArray[np.int64]  # First word of each cell
    places: NDArray[np.float32]  # Coordinates of the words in the first directions
    # low, high: bounding boxes of the cells in these directions
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    ranges: NDArray[np.float64]  # Minimum and maximum of angle and of ratio in each cell


def build_cells(places: NDArray[np.float64], words: Context) -> Cells:
    """Sort words into cells by recursive halving across the widest direction."""
    box = places[:, :DIRECTIONS]
    # The context is a factor: halving the range of angles helps about as much as halving the widest direction.
    weight = float(box[:, 0].std()) / max(float(words.angle.std()), 1e-12)
    table = np.column_stack([box, words.angle * weight])
    order, stack, starts = np.arange(len(places)), [(0, len(places))], []
    while stack:
        first, stop = stack.pop()
        mine = order[first:stop]
        if stop - first <= CELL:
            starts.append(first)
            mine.sort()
            continue
        rows = table[mine]
        half = (stop - first) // 2
        order[first:stop] = mine[np.argpartition(rows[:, int(np.argmax(rows.var(axis=0)))], half)]
        stack += [(first + half, stop), (first, first + half)]
    begin = np.array(starts, dtype=np.int64)
    sorted_box = box[order].astype(np.float32)
    angle, ratio = words.angle[order], words.ratio[order]
    ranges = np.column_stack(
        [
            np.minimum.reduceat(angle, begin),
            np.maximum.reduceat(angle, begin),
            np.minimum.reduceat(ratio.min(axis=1), begin),
            np.maximum.reduceat(ratio.max(axis=1), begin),
        ]
    )
    return Cells(
        order,
        np.append(begin, len(order)),
        np.ascontiguousarray(sorted_box.T),
        np.ascontiguousarray(np.minimum.reduceat(sorted_box, begin).T),
        np.ascontiguousarray(np.maximum.reduceat(sorted_box, begin).T),
        ranges,
    )


@njit(cache=True, nogil=True)
def _closest(value: float, low: float, high: float) -> float:
    """Return the largest similarity of a value with any value in a range."""
    if low <= value <= high:
        return 1.0
    return ratio_similarity(value, low if value < low else high)


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")
def _bound_cells(
    place: NDArray[np.float32], angle: float, ratio: float, cells: Cells, grouped: bool, floor: float,
    factors: NDArray[np.float32], bounds: NDArray[np.float32],
) -> None:  # fmt: skip
    """Set for each cell lower bounds of the context factor and of the distance of its words."""
    n = len(bounds)
    bounds[:] = 0.0
    for c in range(len(place)):
        p, low, high = place[c], cells.low[c], cells.high[c]
        for cell in range(n):
            off = max(low[cell] - p, p - high[cell], np.float32(0.0))
            bounds[cell] += off * off
    for cell in range(n):
        factor = 1.0
        if grouped:
            near = cells.ranges[cell]
            like = _closest(angle, near[0], near[1]) + _closest(ratio, near[2], near[3])
            factor = max(1.0 - 0.5 * like, floor)
        factors[cell] = factor
        bounds[cell] *= np.float32(factor) * _SLACK


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _partial_sums(
    place: NDArray[np.float32], places: NDArray[np.float32], first: int, stop: int, sums: NDArray[np.float32]
) -> None:
    """Sum the first directions of the squared distances to a cell's words."""
    n = stop - first
    sums[:n] = 0.0
    for c in range(len(place)):
        p, row = place[c], places[c, first:stop]
        for j in range(n):
            off = row[j] - p
            sums[j] += off * off


@njit(cache=True, nogil=True)
def search(
    wanted: Context, places: NDArray[np.float32], words: Context, cells: Cells, matching: NDArray[np.int64],
    floor: float, first: int, stop: int, out: NDArray[np.int32], distances: NDArray[np.float64],
) -> None:  # fmt: skip
    """Find the nearest word of each group from `first` to `stop`."""
    n_cells = len(cells.starts) - 1
    factors, bounds = np.empty(n_cells, np.float32), np.empty(n_cells, np.float32)
    sums, done = np.empty(CELL, np.float32), np.zeros(n_cells, np.bool_)
    for i in range(first, stop):
        angle, ratio, features = wanted.angle[i], wanted.ratio[i, 0], wanted.features[i]
        _bound_cells(places[i], angle, ratio, cells, matching.shape[1] > 1, floor, factors, bounds)
        least, least_sum, word = np.inf, np.inf, np.int64(-1)
        done[:] = False
        for turn in range(_FIRST + n_cells):
            cell = np.argmin(np.where(done, np.float32(np.inf), bounds)) if turn < _FIRST else turn - _FIRST
            if done[cell] or bounds[cell] > least:
                continue
            done[cell] = True
            begin = cells.starts[cell]
            _partial_sums(places[i], cells.places, begin, cells.starts[cell + 1], sums)
            for k in range(cells.starts[cell + 1] - begin):
                if sums[k] * factors[cell] * _SLACK > least:
                    continue
                j = begin + k
                factor = context_factor(angle, ratio, words.angle[j], words.ratio[j], floor)
                if sums[k] * factor * _SLACK > least:
                    continue
                limit = least / factor if factor > 0.0 else np.inf
                total = feature_distance(features, ratio, words.features[j], words.ratio[j], matching, limit)
                value = factor * total
                nearer = value < least or (value == least and total < least_sum)
                if nearer or (value == least and total == least_sum and cells.order[j] < word):
                    least, least_sum, word = value, total, cells.order[j]
        out[i], distances[i] = word, least
