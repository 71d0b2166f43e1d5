"""Sorting integer keys in linear time."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_RADIX_BITS = 8
"""Bits of a digit; eleven, with fewer passes, take up to a quarter more time."""
_FEW = 2000
"""Keys that comparisons sort faster."""


@njit(cache=True, nogil=True)
def radix_argsort(keys: NDArray[np.int64], n_bits: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Sort non-negative keys stably, eight bits at a time.

    Parameters
    ----------
    keys : ndarray of int64, shape (n,)
        Keys from 0 to ``2**n_bits - 1``; fewer than 2**31 of them.
    n_bits : int
        Number of low bits to sort by. The time grows with it.

    Returns
    -------
    sorted : ndarray of int64, shape (n,)
        The keys in ascending order.
    order : ndarray of int32, shape (n,)
        Their indices in the input.
    """
    n = len(keys)
    order = np.arange(n).astype(np.int32)
    sorted_keys, spare_keys, spare_order = keys.copy(), np.empty(n, np.int64), np.empty(n, np.int32)
    mask = (1 << _RADIX_BITS) - 1
    starts = np.empty(mask + 2, np.int64)
    for shift in range(0, n_bits, _RADIX_BITS):
        starts[:] = 0
        for i in range(n):
            starts[((sorted_keys[i] >> shift) & mask) + 1] += 1
        for digit in range(mask + 1):
            starts[digit + 1] += starts[digit]
        for i in range(n):
            digit = (sorted_keys[i] >> shift) & mask
            at = starts[digit]
            starts[digit] = at + 1
            spare_keys[at] = sorted_keys[i]
            spare_order[at] = order[i]
        sorted_keys, spare_keys = spare_keys, sorted_keys
        order, spare_order = spare_order, order
    return sorted_keys, order


def rank_integers(values: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct values in ascending order, and the rank of each value.

    Values in a narrow range, such as numbers of objects, are counted, about ten times as fast as sorting.

    Parameters
    ----------
    values : ndarray of int, shape (n,)
        Integers.

    Returns
    -------
    names : ndarray of int64, shape (u,)
        The distinct values, ascending.
    ranks : ndarray of int64, shape (n,)
        Index of each value in `names`.
    """
    if len(values) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    low, high = int(values.min()), int(values.max())
    if high - low >= 4 * len(values):
        if len(values) < _FEW or high - low >= 2**62:
            names, ranks = np.unique(values, return_inverse=True)
            return names.astype(np.int64), ranks.astype(np.int64)
        return _rank_sorted(low, *radix_argsort(values.astype(np.int64) - low, (high - low).bit_length()))
    return _rank_counted(np.ascontiguousarray(values, dtype=np.int64), low, high - low + 1)


@njit(cache=True, nogil=True)
def _rank_counted(values: NDArray[np.int64], low: int, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct values of `n` successive ones from `low`, and the rank of each."""
    rank_of = np.zeros(n, np.int32)
    for i in range(len(values)):
        rank_of[values[i] - low] = 1
    n_distinct = 0
    for k in range(n):
        occurs = rank_of[k]
        rank_of[k] = n_distinct
        n_distinct += occurs
    names, ranks = np.empty(n_distinct, np.int64), np.empty(len(values), np.int64)
    for i in range(len(values)):
        rank = rank_of[values[i] - low]
        ranks[i], names[rank] = rank, values[i]
    return names, ranks


@njit(cache=True, nogil=True)
def _rank_sorted(
    low: int, keys: NDArray[np.int64], order: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct values of sorted keys plus `low`, and the rank of each key in the order before sorting."""
    names, ranks = np.empty(len(keys), np.int64), np.empty(len(keys), np.int64)
    n = 0
    for i in range(len(keys)):
        if i == 0 or keys[i] != keys[i - 1]:
            names[n] = keys[i] + low
            n += 1
        ranks[order[i]] = n - 1
    return names[:n].copy(), ranks


def order_of(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Sort integers stably, as fast as their range allows.

    Parameters
    ----------
    keys : ndarray of int64, shape (n,)
        Integers in a range below 2**63; fewer than 2**31 of them. Different ones in a range of four times their number,
        such as rows of a part of a file, take one pass, others that of `radix_argsort`.

    Returns
    -------
    sorted : ndarray of int64, shape (n,)
        The keys in ascending order.
    order : ndarray of int32, shape (n,)
        Their indices in the input.
    """
    if len(keys) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int32)
    low, high = int(keys.min()), int(keys.max())
    if high - low < 4 * len(keys):
        names, order = _place_distinct(keys, low, high - low + 1)
        if len(names) == len(keys):
            return names, order
    ordered, order = radix_argsort(keys - low, (high - low).bit_length())
    return ordered + low, order


@njit(cache=True, nogil=True)
def _place_distinct(keys: NDArray[np.int64], low: int, n: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return the distinct keys in ascending order and an index of each."""
    place = np.full(n, -1, np.int32)
    n_distinct = 0
    for i in range(len(keys)):
        step = keys[i] - low
        n_distinct += place[step] < 0
        place[step] = i
    names, order = np.empty(n_distinct, np.int64), np.empty(n_distinct, np.int32)
    at = 0
    for step in range(n):
        if place[step] >= 0:
            names[at], order[at] = step + low, place[step]
            at += 1
    return names, order
