"""Statistical outlier removal."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, check_xyz

QUERY_SIZE = 100_000
"""Query points per batch; bounds the memory of the neighbour lists."""


def keep_inliers(xyz: ArrayLike, *, n_neighbors: int = 20, std_ratio: float = 2.0) -> NDArray[np.bool_]:
    """Return the inliers of statistical outlier removal.

    The spacing of a point is the mean distance to its `n_neighbors` nearest points, itself (at distance 0) included.
    Inliers have a spacing of at most the mean spacing plus `std_ratio` standard deviations. This is the rule of
    Open3D's ``remove_statistical_outlier``: points of spacing 0 enter the mean, but not the standard deviation. Unlike
    Open3D, which removes them, points of spacing 0 (`n_neighbors` or more duplicates) are inliers.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres.
    n_neighbors : int, default 20
        Nearest points including the point itself, at least 2. Larger values detect larger clusters of outliers.
    std_ratio : float, default 2.0
        Threshold in standard deviations above the mean spacing. Smaller values remove more points.

    Returns
    -------
    ndarray of bool, shape (n,)
        True for inliers. With fewer than `n_neighbors` points, all are neighbours; a single point is an inlier.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3), or a coordinate is NaN or infinite.
    ParameterError
        If `n_neighbors` is below 2 or `std_ratio` is not positive.

    Notes
    -----
    About 1 second per 100,000 points, in one thread.
    """
    check_positive(std_ratio, "std_ratio")
    check_at_least(n_neighbors, 2, "n_neighbors")
    points = check_xyz(xyz).astype(np.float64)
    if len(points) < 2:
        return np.ones(len(points), dtype=np.bool_)
    points -= points.min(axis=0)
    tree = cKDTree(points)
    k = min(n_neighbors, len(points))
    spacing = np.empty(len(points))
    for start in range(0, len(points), QUERY_SIZE):
        distance, _ = tree.query(points[start : start + QUERY_SIZE], k=k, workers=1)
        spacing[start : start + QUERY_SIZE] = distance.mean(axis=1)
    mean = spacing.mean()
    deviation = np.sqrt(((spacing[spacing > 0] - mean) ** 2).sum() / (len(points) - 1))
    return spacing <= mean + std_ratio * deviation
