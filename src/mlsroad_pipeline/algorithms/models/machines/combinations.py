"""Combinations of the voxels or superpoints of several models."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    n_pairs = 0
    for k in range(n_first):  # `at` becomes the first pair of each group
        at[k] = n_pairs
        own = grouped[starts[k] : starts[k + 1]]
        if len(own) > _FEW_PAIRS:
            own.sort()
        for j in range(len(own)):
            n_pairs += _insert(second_of, at[k], n_pairs, own[j])
        first_of[at[k] : n_pairs] = k
    ranks = np.full(n, -1, np.int32)
    for i in range(n):
        k = first[i]
        if k >= 0 and second[i] >= 0:
            stop = at[k + 1] if k + 1 < n_first else n_pairs
            ranks[i] = at[k] + np.searchsorted(second_of[at[k] : stop], second[i])
    return first_of[:n_pairs].copy(), second_of[:n_pairs].copy(), ranks
