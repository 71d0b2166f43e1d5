"""Stray points told from surfaces by the distance to their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, check_xyz

QUERY_SIZE = 100_000
"""Points asked for at once; bounds the memory of the neighbour lists, not the result."""


def keep_inliers(xyz: ArrayLike, *, n_neighbors: int = 20, std_ratio: float = 2.0) -> NDArray[np.bool_]:
    """Tell the points to keep in statistical outlier removal.

    A point's spacing is the mean distance to its `n_neighbors` nearest points, itself (at distance 0) counted among
    them. Points are kept whose spacing is at most the mean spacing plus `std_ratio` standard deviations. This is the
    rule of Open3D's ``remove_statistical_outlier``, its detail included that points of spacing 0 count in the mean but
    their deviations do not. On purpose one thing differs: such piles of `n_neighbors` or more coinciding points are no
    outliers and stay, where Open3D drops them.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres.
    n_neighbors : int, default 20
        Nearest points, the point itself included, so at least 2. More of them find larger clumps of stray points.
    std_ratio : float, default 2.0
        How many standard deviations above the mean spacing is still kept. Lower values drop more.

    Returns
    -------
    ndarray of bool, shape (n,)
        True keeps. With fewer points than neighbours all there are count; a single point is kept.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3), or holds NaN or infinite coordinates.
    ParameterError
        If `n_neighbors` is below 2 or `std_ratio` is not positive.

    Notes
    -----
    About 1 second per 100,000 points, in the caller's thread.
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
