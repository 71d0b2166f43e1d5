"""Merge of the points of several scanners by time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray


def merge_by_time(parts: Sequence[dict[str, NDArray]]) -> dict[str, NDArray]:
    """Merge the columns of one or more scanners, each sorted by `gps_time`; at ties the first part leads."""
    columns = parts[0]
    for part in parts[1:]:
        rows = _merged_rows(columns["gps_time"], part["gps_time"])
        columns = {name: _interleave(values, part[name], *rows) for name, values in columns.items()}
    return columns


@njit(cache=True, nogil=True)
def _merged_rows(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the row of each element of two sorted sequences in their merge; at ties the first leads."""
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


def _interleave(first: NDArray, second: NDArray, of_first: NDArray[np.int64], of_second: NDArray[np.int64]) -> NDArray:
    out = np.empty((len(first) + len(second), *first.shape[1:]), dtype=first.dtype)
    out[of_first] = first
    out[of_second] = second
    return out
