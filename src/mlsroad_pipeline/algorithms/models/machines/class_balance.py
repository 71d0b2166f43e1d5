"""Training labels of groups of points: majority classes, balanced samples and class weights.

A group is a supervoxel, a patch or an object.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column

EXPONENTS = {"balanced": 0.0, "sqrt": 0.5, "none": 1.0}
"""Class weight to exponent: the total weight of a class is its number of groups raised to this power."""


def majority_labels(
    point_labels: ArrayLike, group_of_point: ArrayLike, n_classes: int
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return the majority class of the labelled points of each group."""
    owners = np.asarray(group_of_point)
    classes = check_column(point_labels, len(owners), "point_labels")
    if len(owners) == 0:
        return np.empty(0, np.int16), np.empty(0, np.float32)
    if classes.min() < IGNORE or classes.max() >= n_classes:
        raise DataError(f"point_labels must be in -1..{n_classes - 1}, got {classes.min()}..{classes.max()}")
    if owners.min() < 0:
        raise DataError(f"group_of_point must not be negative, got {owners.min()}")
    n_groups = int(owners.max()) + 1
    # Column 0 counts unlabelled points; this avoids a filtered copy of both arrays.
    cells = owners.astype(np.int64) * (n_classes + 1) + (classes.astype(np.int64) + 1)
    counts = np.bincount(cells, minlength=n_groups * (n_classes + 1)).reshape(n_groups, -1)[:, 1:]
    total = counts.sum(axis=1)
    labels = np.where(total > 0, counts.argmax(axis=1), IGNORE).astype(np.int16)
    purity = counts.max(axis=1) / np.where(total > 0, total, np.nan)
    return labels, purity.astype(np.float32)


def draw_per_class(target: NDArray[np.integer], limit: int | None, *, seed: int) -> NDArray[np.int64]:
    """Draw a random sample with a maximum size per class."""
    rng = np.random.default_rng(seed)
    drawn = []
    for label in np.unique(target[target >= 0]):
        rows = np.flatnonzero(target == label)
        drawn.append(rows if limit is None or len(rows) <= limit else rng.choice(rows, limit, replace=False))
    return np.sort(np.concatenate(drawn)) if drawn else np.empty(0, np.int64)


def class_weights(sizes: NDArray[np.integer], drawn: NDArray[np.integer], class_weight: str) -> dict[int, float] | None:
    """Return the weight of one sample of each class."""
    total = sizes.astype(np.float64) ** EXPONENTS[class_weight]
    weights = total / drawn * (drawn.sum() / total.sum())
    return None if np.allclose(weights, 1.0) else dict(enumerate(weights.tolist()))
