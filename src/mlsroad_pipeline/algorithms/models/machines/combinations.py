"""Combinations of the voxels or superpoints of several models, and decisions by groups of classes."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.sorting import lower_bound, sort_floats


def decide(
    probabilities: NDArray[np.float64], groups: NDArray[np.integer] | None = None
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return the most probable class of each row, and the probability that it is right.

    Examples
    --------
    >>> import numpy as np
    >>> decide(np.array([[0.4, 0.3, 0.3]]), np.array([0, 1, 1]))
    (array([1], dtype=int16), array([0.6], dtype=float32))
    """
    if groups is None:
        return probabilities.argmax(axis=1).astype(np.int16), largest_of_rows(probabilities)[:, 0].astype(np.float32)
    of_group = probabilities @ (groups[:, None] == np.arange(int(groups.max()) + 1)).astype(np.float64)
    return _best_of_groups(probabilities, of_group, groups.astype(np.int64))


@njit(cache=True, nogil=True)
def _best_of_groups(
    probabilities: NDArray[np.floating], of_group: NDArray[np.float64], groups: NDArray[np.int64]
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return the best class of the best group of each row, and the probability of the group."""
    labels, confidence = np.zeros(len(of_group), np.int16), np.empty(len(of_group), np.float32)
    for i in range(len(of_group)):
        group = 0
        for g in range(1, of_group.shape[1]):
            if of_group[i, g] > of_group[i, group]:
                group = g
        confidence[i] = of_group[i, group]
        best = -1.0
        for c in range(len(groups)):
            if groups[c] == group and probabilities[i, c] > best:
                best, labels[i] = probabilities[i, c], c
    return labels, confidence


@njit(cache=True, nogil=True)
def largest_of_rows(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the largest value of each row; several times as fast as NumPy for few columns."""
    largest = values[:, :1].copy()
    for i in range(len(values)):
        for k in range(1, values.shape[1]):
            if values[i, k] > largest[i, 0] or np.isnan(values[i, k]):
                largest[i, 0] = values[i, k]
    return largest


_FEW_PAIRS = 64
"""Members of a group that are inserted one by one; more are sorted first."""


@njit(cache=True, nogil=True)
def _insert(values: NDArray[np.int32], start: int, stop: int, value: int) -> int:
    """Insert a value into ascending ones unless it is among them; return the number of new values."""
    at = stop
    while at > start and values[at - 1] > value:
        at -= 1
    if at > start and values[at - 1] == value:
        return 0
    for k in range(stop, at, -1):
        values[k] = values[k - 1]
    values[at] = value
    return 1


@njit(cache=True, nogil=True)
def rank_pairs(
    first: NDArray[np.int32], second: NDArray[np.int32], n_first: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return the distinct pairs in ascending order, and the rank of each pair.

    The time is linear for groups in which the first number is the same and few second ones occur.
    """
    n = len(first)
    starts = np.zeros(n_first + 1, np.int64)
    for i in range(n):
        if first[i] >= 0 and second[i] >= 0:
            starts[first[i] + 1] += 1
    for k in range(n_first):
        starts[k + 1] += starts[k]
    grouped, at = np.empty(starts[n_first], np.int32), starts[:n_first].copy()
    for i in range(n):
        if first[i] >= 0 and second[i] >= 0:
            grouped[at[first[i]]] = second[i]
            at[first[i]] += 1
    first_of, second_of = np.empty(len(grouped), np.int32), np.empty(len(grouped), np.int32)
    n_pairs = np.int64(0)
    for k in range(n_first):  # `at` becomes the first pair of each group
        at[k] = n_pairs
        own = grouped[starts[k] : starts[k + 1]]
        if len(own) > _FEW_PAIRS:
            sort_floats(own, len(own))
        for j in range(len(own)):
            n_pairs += _insert(second_of, at[k], n_pairs, own[j])
        for j in range(at[k], n_pairs):
            first_of[j] = k
    ranks = np.full(n, -1, np.int32)
    for i in range(n):
        k = first[i]
        if k >= 0 and second[i] >= 0:
            stop = at[k + 1] if k + 1 < n_first else n_pairs
            ranks[i] = at[k] + lower_bound(second_of[at[k] : stop], second[i])
    return first_of[:n_pairs].copy(), second_of[:n_pairs].copy(), ranks
