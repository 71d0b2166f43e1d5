"""Sorting integer keys in linear time."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_RADIX_BITS = 11


@njit(cache=True)
def radix_argsort(keys: NDArray[np.int64], n_bits: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Sort keys stably, eleven bits at a time.

    Parameters
    ----------
    keys : ndarray of int64, shape (n,)
        Keys from 0 to ``2**n_bits - 1``; fewer than 2**31 of them.
    n_bits : int
        How many low bits to sort by: the time grows with it.

    Returns
    -------
    sorted : ndarray of int64, shape (n,)
        The keys in ascending order.
    order : ndarray of int32, shape (n,)
        Their places in the input.
    """
    n = len(keys)
    order = np.arange(n).astype(np.int32)
    sorted_keys, spare_keys, spare_order = keys.copy(), np.empty(n, np.int64), np.empty(n, np.int32)
    size = 1 << _RADIX_BITS
    for shift in range(0, n_bits, _RADIX_BITS):
        starts = np.zeros(size + 1, np.int64)
        for i in range(n):
            starts[((sorted_keys[i] >> shift) & (size - 1)) + 1] += 1
        for b in range(size):
            starts[b + 1] += starts[b]
        for i in range(n):
            digit = (sorted_keys[i] >> shift) & (size - 1)
            spare_keys[starts[digit]] = sorted_keys[i]
            spare_order[starts[digit]] = order[i]
            starts[digit] += 1
        sorted_keys, spare_keys = spare_keys, sorted_keys
        order, spare_order = spare_order, order
    return sorted_keys, order


def rank_integers(values: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find the different values, and which of them each is.

    Numbers of objects lie close together: they are counted, which is some ten times as fast as sorting them.

    Parameters
    ----------
    values : ndarray of int, shape (n,)
        Integers.

    Returns
    -------
    names : ndarray of int64, shape (u,)
        The values that occur, ascending.
    ranks : ndarray of int64, shape (n,)
        The place of each value in `names`.
    """
    if len(values) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    low, high = int(values.min()), int(values.max())
    if high - low >= 4 * len(values):
        names, ranks = np.unique(values, return_inverse=True)
        return names.astype(np.int64), ranks.astype(np.int64)
    steps = values.astype(np.int64) - low
    occurs = np.zeros(high - low + 1, dtype=np.bool_)
    occurs[steps] = True
    return np.flatnonzero(occurs) + low, (np.cumsum(occurs) - 1)[steps]
