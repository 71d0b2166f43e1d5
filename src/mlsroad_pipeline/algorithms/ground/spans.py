"""Ranges of points for threads, and the validation and bounds of coordinates in one pass."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_xyz

Span: TypeAlias = tuple[int, int]
"""First point of a range and one past its last."""

MAX_Z_RANGE = 1e5
"""Maximum height range, metres; float32 resolves it to a centimetre."""


def in_chunks(n_points: int, n_threads: int, work: Callable[[Span], Any]) -> list[Any]:
    """Call ``work((start, stop))`` on contiguous ranges of points, one per thread."""
    bounds = np.linspace(0, n_points, n_threads + 1).astype(np.int64)
    spans = [(int(start), int(stop)) for start, stop in pairwise(bounds)]
    if n_threads == 1:
        return [work(spans[0])]
    with ThreadPoolExecutor(n_threads) as pool:
        return list(pool.map(work, spans))


@njit(cache=True, nogil=True)
def point_bounds(xyz: NDArray[np.floating], span: Span) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Return minimum and maximum coordinates of a range, and whether all are finite, in one pass."""
    low = np.full(3, np.inf)
    high = np.full(3, -np.inf)
    sums = np.zeros(3)
    for i in range(span[0], span[1]):
        for k in range(3):
            value = np.float64(xyz[i, k])
            low[k] = min(low[k], value)
            high[k] = max(high[k], value)
            sums[k] += value - value  # 0 for finite values, NaN for NaN and infinity
    return low, high, bool((sums == 0.0).all())


def bounds_of(
    xyz: ArrayLike, n_threads: int = 1
) -> tuple[NDArray[np.floating], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Validate coordinates and return them with their bounds, in one pass."""
    points = np.asarray(xyz)
    usable = points.dtype in (np.float32, np.float64) and points.ndim == 2 and points.shape[1] == 3
    points = np.ascontiguousarray(points) if usable else check_xyz(xyz)
    parts = in_chunks(len(points), n_threads, lambda span: point_bounds(points, span))
    low = np.min([part[0] for part in parts], axis=0)
    high = np.max([part[1] for part in parts], axis=0)
    if not all(part[2] for part in parts):
        check_xyz(points)
    if len(points) and high[2] - low[2] > MAX_Z_RANGE:
        raise DataError(f"xyz spans {high[2] - low[2]:g} m in z, more than {MAX_Z_RANGE:g}: remove outliers")
    return points, (low, high)
