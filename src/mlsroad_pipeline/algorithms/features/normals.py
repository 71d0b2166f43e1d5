"""Normals of points, with defined orientation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.features.eigen import compute_eigen_features


def compute_normals(
    xyz: ArrayLike,
    *,
    radius: float | None = None,
    k: int | None = None,
    viewpoint: ArrayLike | None = None,
    n_threads: int = 1,
) -> NDArray[np.float32]:
    """Estimate the surface normal at each point.

    The normal is the direction of smallest variance of the neighbourhood.
    """
    points = check_xyz(xyz)
    features = compute_eigen_features(points, radius=radius, k=k, n_threads=n_threads)
    normals = np.stack([features["nx"], features["ny"], features["nz"]], axis=1)
    if viewpoint is None:
        return normals
    place = np.asarray(viewpoint, dtype=np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise DataError(f"viewpoint must be three finite coordinates, got {viewpoint!r}")
    away = ((place - points) * normals).sum(axis=1) < 0
    return np.where(away[:, None], -normals, normals)
