"""Statistical outlier removal."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.spacing import mean_spacing


def keep_inliers(
    xyz: ArrayLike, *, n_neighbors: int = 20, std_ratio: float = 2.0, n_threads: int = 1
) -> NDArray[np.bool_]:
    """Return the inliers of statistical outlier removal.

    The spacing of a point is the mean distance to its `n_neighbors` nearest points, itself (at distance 0) included.
    Inliers have a spacing of at most the mean spacing plus `std_ratio` standard deviations.
    """
    check_positive(std_ratio, "std_ratio")
    check_at_least(n_neighbors, 2, "n_neighbors")
    points = check_xyz(xyz).astype(np.float64)
    if len(points) < 2:
        return np.ones(len(points), dtype=np.bool_)
    spacing = mean_spacing(points, k=min(n_neighbors, len(points)), n_threads=n_threads)
    mean = spacing.mean()
    deviation = np.sqrt(((spacing[spacing > 0] - mean) ** 2).sum() / (len(points) - 1))
    return spacing <= mean + std_ratio * deviation
