"""Intensities of a scene: gaps filled, and ranks, which do not depend on the sensor's unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort, rank_few


def known_intensity(intensity: NDArray) -> NDArray | None:
    """Return intensities with the median in place of NaN.

    Examples
    --------
    >>> known_intensity(np.array([0.1, np.nan, 0.5, 0.3])).tolist()
    [0.1, 0.3, 0.5, 0.3]
    """
    missing = np.isnan(intensity)
    known = intensity[~missing]
    if not len(known) or known.min() == known.max():
        return None
    return np.where(missing, np.median(known), intensity) if missing.any() else intensity


def rank_within(values: ArrayLike) -> NDArray[np.float64]:
    """Return the rank of each value among all, as a share; equal values share their mean rank."""
    numbers = np.ascontiguousarray(values, dtype=np.float32) + np.float32(0)  # -0 becomes 0
    if np.isnan(numbers).any():
        raise DataError(f"intensity is NaN in row {int(np.argmax(np.isnan(numbers)))}")
    few = rank_few(numbers)
    if few is not None:
        return (few - 0.5) / len(numbers)
    bits = numbers.view(np.int32).astype(np.int64)
    ordered, order = radix_argsort(np.where(bits < 0, -bits - 1, bits + 2**31), 32)
    edge = np.flatnonzero(np.diff(ordered, prepend=ordered[:1] - 1, append=ordered[-1:] + 1))
    ranks = np.empty(len(numbers))
    ranks[order] = np.repeat((edge[1:] + edge[:-1]) / (2 * len(numbers)), np.diff(edge))
    return ranks
