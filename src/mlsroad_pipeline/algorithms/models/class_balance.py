"""How much each class counts in training: at most so many supervoxels of it, and each with what weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError

EXPONENTS = {"balanced": 0.0, "sqrt": 0.5, None: 1.0}
"""Class weight to the exponent of a class's size that all its supervoxels together weigh."""


def draw_per_class(target: NDArray[np.integer], limit: int | None, *, seed: int) -> NDArray[np.int64]:
    """Draw at most so many supervoxels of each class.

    Parameters
    ----------
    target : ndarray of int, shape (s,)
        Class of each supervoxel; -1 is left out.
    limit : int or None
        Most supervoxels of a class; None takes all.
    seed : int
        Seed of the draw.

    Returns
    -------
    ndarray of int64
        Their rows, ascending.
    """
    rng = np.random.default_rng(seed)
    drawn = []
    for label in np.unique(target[target >= 0]):
        rows = np.flatnonzero(target == label)
        drawn.append(rows if limit is None or len(rows) <= limit else rng.choice(rows, limit, replace=False))
    return np.sort(np.concatenate(drawn)) if drawn else np.empty(0, np.int64)


def class_weights(
    sizes: NDArray[np.integer], drawn: NDArray[np.integer], class_weight: str | None
) -> dict[int, float] | None:
    """Weigh the supervoxels of each class.

    Parameters
    ----------
    sizes : ndarray of int, shape (c,)
        Supervoxels of each class, all above 0.
    drawn : ndarray of int, shape (c,)
        How many of them are trained on, all above 0.
    class_weight : {"balanced", "sqrt"} or None
        All supervoxels of a class together weigh the same, the square root of their number, or their number.

    Returns
    -------
    dict of int to float or None
        Weight of one supervoxel of each class, 1 on average; None where all weigh alike.
    """
    total = sizes.astype(np.float64) ** EXPONENTS[class_weight]
    weights = total / drawn * (drawn.sum() / total.sum())
    return None if np.allclose(weights, 1.0) else dict(enumerate(weights.tolist()))


def check_weight(sample_weight: ArrayLike | None, n: int) -> NDArray[np.float64] | None:
    """Return the weights of supervoxels as an array, or say what is wrong with them.

    Parameters
    ----------
    sample_weight : array-like of shape (n,) or None
        Weights; None stays None.
    n : int
        Number of supervoxels.

    Returns
    -------
    ndarray of float64, shape (n,), or None
        The weights.

    Raises
    ------
    DataError
        If there are not `n` of them, or one is negative or not finite.
    """
    if sample_weight is None:
        return None
    weight = np.asarray(sample_weight, dtype=np.float64)
    if weight.shape != (n,):
        raise DataError(f"sample_weight must have shape ({n},), got {weight.shape}")
    if not np.isfinite(weight).all() or (weight < 0).any():
        raise DataError("sample_weight must be finite and not negative")
    return weight
