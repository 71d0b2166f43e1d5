"""Point labels from supervoxel probabilities."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.features.detrending import local_tendency
from mlsroad_pipeline.papers.tomic2019.detrended_forest.nearest import nearest_supervoxels


def smooth_probabilities(
    probabilities: NDArray[np.float32], adjacency: csr_array, *, weight: float
) -> NDArray[np.float32]:
    """Smooth class probabilities over first-order neighbours.

    Tomic et al. 2019, section 4, mention this local regularisation without a formula. Here
    P' = (1 - weight) P + weight mean(P of the neighbours).

    Parameters
    ----------
    probabilities : ndarray of float32, shape (s, c)
        Class probabilities of the supervoxels.
    adjacency : csr_array of shape (s, s)
        First-order neighbours.
    weight : float
        Weight of the neighbours, 0 to 1. Larger values remove more isolated supervoxels, both wrong and right ones.

    Returns
    -------
    ndarray of float32, shape (s, c)
        Smoothed probabilities; unchanged for supervoxels without neighbours.

    Raises
    ------
    DataError
        If the shape of the adjacency does not match.
    ParameterError
        If `weight` is outside 0 to 1.
    """
    if not 0 <= weight <= 1:
        raise ParameterError(f"weight must be in [0, 1], got {weight!r}")
    n = len(probabilities)
    if adjacency.shape != (n, n):
        raise DataError(f"adjacency must have shape ({n}, {n}), got {adjacency.shape}")
    share = np.float32(weight)
    mixed = (1 - share) * probabilities + share * local_tendency(probabilities, adjacency)
    alone = np.diff(adjacency.indptr) == 0
    return np.where(alone[:, None], probabilities, mixed)


def label_points(
    xyz: ArrayLike,
    centroids: ArrayLike,
    probabilities: ArrayLike,
    *,
    rule: Literal["nearest", "own"] = "nearest",
    supervoxel_labels: ArrayLike | None = None,
    n_threads: int = 1,
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Assign to each point the most probable class of its supervoxel (Tomic et al. 2019, sections 2 and 3.3).

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    centroids : array-like of shape (s, 3)
        Centroids of the supervoxels in the same frame, metres; unused with the rule "own".
    probabilities : array-like of shape (s, c)
        Class probabilities of the supervoxels.
    rule : {"nearest", "own"}, default "nearest"
        Supervoxel with the nearest centroid (the paper), or the supervoxel that contains the point.
    supervoxel_labels : array-like of int, shape (n,), optional
        Supervoxel of each point; required by the rule "own".
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Class of each point, the lowest of equally probable ones.
    confidence : ndarray of float32, shape (n,)
        Probability of the class.

    Raises
    ------
    DataError
        If coordinates are not (n, 3) and finite, probabilities are not (s, c) and finite, or the rule "own" lacks valid
        supervoxel labels.
    ParameterError
        If the rule is unknown or `n_threads` is below 1.
    """
    table = np.asarray(probabilities, dtype=np.float32)
    n_supervoxels = len(np.asarray(centroids))
    if table.ndim != 2 or len(table) != n_supervoxels or not table.shape[1] or not np.isfinite(table).all():
        raise DataError(f"probabilities must be finite, of shape ({n_supervoxels}, c), got {table.shape}")
    if rule == "nearest":
        owners = nearest_supervoxels(xyz, centroids, n_threads=n_threads)
    elif rule == "own":
        if supervoxel_labels is None:
            raise DataError("rule 'own' needs supervoxel_labels")
        owners = check_column(supervoxel_labels, len(check_xyz(xyz)), "supervoxel_labels")
        if len(owners) and not 0 <= int(owners.min()) <= int(owners.max()) < n_supervoxels:
            raise DataError(f"supervoxel_labels must be in 0..{n_supervoxels - 1}, got {owners.min()}..{owners.max()}")
    else:
        raise ParameterError(f"rule must be 'nearest' or 'own', got {rule!r}")
    best = table.argmax(axis=1)
    return best.astype(np.int16)[owners], table.max(axis=1)[owners]
