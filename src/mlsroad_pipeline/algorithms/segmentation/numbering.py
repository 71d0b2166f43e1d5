"""Numbering of objects by their first points."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.validation import check_at_least


def number_objects(parts: NDArray[np.int64], min_points: int) -> NDArray[np.int32]:
    """Number parts 0, 1, ... by their first points.

    Parameters
    ----------
    parts : ndarray of int64, shape (n,)
        Part of each point, at least 0.
    min_points : int
        Parts with fewer points become -1.

    Returns
    -------
    ndarray of int32, shape (n,)
        Object of each point.

    Raises
    ------
    ParameterError
        If `min_points` is below 1.
    """
    check_at_least(min_points, 1, "min_points")
    return np.zeros(0, np.int32) if len(parts) == 0 else _numbered(parts, min_points)


@njit(cache=True, nogil=True)
def _numbered(parts: NDArray[np.int64], min_points: int) -> NDArray[np.int32]:
    counts = np.zeros(parts.max() + 1, np.int64)
    for part in parts:
        counts[part] += 1
    number = np.full(len(counts), -1, np.int32)
    out = np.empty(len(parts), np.int32)
    n_objects = 0
    for i in range(len(parts)):
        part = parts[i]
        if counts[part] < min_points:
            out[i] = -1
            continue
        if number[part] < 0:
            number[part] = n_objects
            n_objects += 1
        out[i] = number[part]
    return out
