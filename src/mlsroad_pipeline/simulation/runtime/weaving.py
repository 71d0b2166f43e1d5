"""Putting the points of several scanners into the order of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray


def in_order_of_time(parts: Sequence[dict[str, NDArray]]) -> dict[str, NDArray]:
    """Merge columns that each are in the order of time already.

    Parameters
    ----------
    parts : sequence of dict of str to ndarray
        Of each scanner, with the same columns; `gps_time` among them, rising. At least one.

    Returns
    -------
    dict of str to ndarray
        The columns of all, in the order of `gps_time`; at ties the first part leads.
    """
    columns = parts[0]
    for part in parts[1:]:
        places = _places(columns["gps_time"], part["gps_time"])
        columns = {name: _woven(values, part[name], *places) for name, values in columns.items()}
    return columns


@njit(cache=True, nogil=True)
def _places(first: NDArray[np.float64], second: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the rows of two rising sequences go when they are merged; at ties the first leads."""
    of_first, of_second = np.empty(len(first), np.int64), np.empty(len(second), np.int64)
    i = j = 0
    for k in range(len(first) + len(second)):
        if i == len(first) or (j < len(second) and second[j] < first[i]):
            of_second[j] = k
            j += 1
        else:
            of_first[i] = k
            i += 1
    return of_first, of_second


def _woven(first: NDArray, second: NDArray, of_first: NDArray[np.int64], of_second: NDArray[np.int64]) -> NDArray:
    out = np.empty((len(first) + len(second), *first.shape[1:]), dtype=first.dtype)
    out[of_first] = first
    out[of_second] = second
    return out
