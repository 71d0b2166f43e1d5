"""The class of most points: what groups of points, such as supervoxels and patches, are trained as."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column


def majority_labels(
    point_labels: ArrayLike, group_of_point: ArrayLike, n_classes: int
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give each group the class of most of its labelled points.

    Parameters
    ----------
    point_labels : array-like of int, shape (n,)
        Class of each point, 0 to `n_classes` - 1; -1 is ignored.
    group_of_point : array-like of int, shape (n,)
        Group of each point, such as its supervoxel or patch, from 0.
    n_classes : int
        Number of classes.

    Returns
    -------
    labels : ndarray of int16, shape (s,)
        Majority class, of equal counts the lowest; -1 where no point is labelled.
    purity : ndarray of float32, shape (s,)
        Share of the majority class among the group's labelled points; NaN where none is.

    Raises
    ------
    DataError
        If the two columns differ in length, a class is outside -1 to `n_classes` - 1 or a group is negative.
    """
    owners = np.asarray(group_of_point)
    classes = check_column(point_labels, len(owners), "point_labels")
    if len(owners) == 0:
        return np.empty(0, np.int16), np.empty(0, np.float32)
    if classes.min() < IGNORE or classes.max() >= n_classes:
        raise DataError(f"point_labels must be in -1..{n_classes - 1}, got {classes.min()}..{classes.max()}")
    if owners.min() < 0:
        raise DataError(f"group_of_point must not be negative, got {owners.min()}")
    n_groups = int(owners.max()) + 1
    # Ignored points are counted in a column of their own, so that no copy of the others is needed.
    cells = owners.astype(np.int64) * (n_classes + 1) + (classes.astype(np.int64) + 1)
    counts = np.bincount(cells, minlength=n_groups * (n_classes + 1)).reshape(n_groups, -1)[:, 1:]
    total = counts.sum(axis=1)
    labels = np.where(total > 0, counts.argmax(axis=1), IGNORE).astype(np.int16)
    purity = counts.max(axis=1) / np.where(total > 0, total, np.nan)
    return labels, purity.astype(np.float32)
