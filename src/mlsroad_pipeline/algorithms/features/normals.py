"""Normals of points with a defined orientation, and features of the orientation of supervoxels."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.features.eigen import (
    EIGEN_FEATURES,
    SHAPE_FEATURES,
    compute_eigen_features,
    emit_features,
)
from mlsroad_pipeline.algorithms.features.eigen_solver import solve_symmetric

ORIENTATION_FEATURES = ("normal_z", "verticality", "direction_z")
"""Features that do not change with a rotation about the vertical axis: the direction of a street has no influence."""
_SOURCES = ("nz", "verticality", "direction_z")
_DESCRIBED = [EIGEN_FEATURES.index(name) for name in (*SHAPE_FEATURES, *_SOURCES)]
"""Columns of eigenvalue features that `describe_shape` returns."""


def describe_shape(covariances: NDArray[np.float64], counts: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return shape and orientation features from covariances."""
    n = len(counts)
    values, smallest, largest = np.empty((3, n)), np.empty((3, n)), np.empty((3, n))
    solve_symmetric(covariances, n, values, smallest, largest)
    rows = np.empty((n, len(EIGEN_FEATURES)), np.float32)
    emit_features(values, smallest, largest, counts, np.arange(n, dtype=np.int32), 0, n, rows)
    return rows.take(_DESCRIBED, axis=1)


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
