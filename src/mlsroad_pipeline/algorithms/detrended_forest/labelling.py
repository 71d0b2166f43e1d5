"""From supervoxels to points: which supervoxel a point takes its label from."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.detrended_forest.nearest import nearest_supervoxels
from mlsroad_pipeline.algorithms.features.detrending import local_tendency


def smooth_probabilities(
    probabilities: NDArray[np.float32], adjacency: csr_array, *, weight: float
) -> NDArray[np.float32]:
    """Let the first-order neighbours of a supervoxel have a say in its class.

    The local context regularises the labels (Tomic et al. 2019, section 4, speak of it without a formula):
    P' = (1 - weight) P + weight mean(P of the neighbours).

    Parameters
    ----------
    probabilities : ndarray of float32, shape (s, c)
        Class probabilities of the supervoxels.
    adjacency : csr_array of shape (s, s)
        First-order neighbours.
    weight : float
        Weight of the neighbours, 0 to 1. More wipes out single mistaken supervoxels, and single supervoxels that are
        right.

    Returns
    -------
    ndarray of float32, shape (s, c)
        Probabilities; a supervoxel without neighbours keeps its own.

    Raises
    ------
    DataError
        If the adjacency has another number of supervoxels.
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
    """Give every point the most probable class of its supervoxel (Tomic et al. 2019, section 2 and 3.3).

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    centroids : array-like of shape (s, 3)
        Centroids of the supervoxels, metres, in the same frame; not used by the rule "own".
    probabilities : array-like of shape (s, c)
        Class probabilities of the supervoxels.
    rule : {"nearest", "own"}, default "nearest"
        The supervoxel whose centroid is nearest (the paper), or the one that the point belongs to.
    supervoxel_labels : array-like of int, shape (n,), optional
        Supervoxel of each point; needed by the rule "own" only.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Class of each point, of equally probable ones the lowest.
    confidence : ndarray of float32, shape (n,)
        Its probability.

    Raises
    ------
    DataError
        If coordinates are not (n, 3) and finite, probabilities are not (s, c) and finite, the rule "own" has no
        supervoxel labels, or they do not fit the points or the supervoxels.
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
