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
    """Assign to each point the most probable class of its supervoxel (Tomic et al. 2019, sections 2 and 3.3)."""
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
