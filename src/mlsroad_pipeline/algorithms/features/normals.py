"""Normals of points, with a stated side."""

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
    """Estimate the normal of the surface at every point.

    The normal is the direction in which the points around spread least.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    radius : float, optional
        Neighbourhood radius in metres, the point itself included. Larger values smooth over noise and round edges off.
    k : int, optional
        Neighbourhood of the k nearest points, the point itself included. Exactly one of `radius` and `k` is given.
    viewpoint : array-like of shape (3,), optional
        A place that all normals shall face, metres; by default they point upwards (nz >= 0). On vertical surfaces
        seen without a viewpoint, noise decides the side.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of float32, shape (n, 3)
        Unit normals; NaN where fewer than three points or only collinear ones are near.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) and finite, its extent is too large for the radius, or `viewpoint` is not three finite
        numbers.
    ParameterError
        If not exactly one of `radius` and `k` is given, `radius` is not positive, or `k` or `n_threads` is below 1.
    """
    points = check_xyz(xyz)
    found = compute_eigen_features(points, radius=radius, k=k, n_threads=n_threads)
    normals = np.stack([found["nx"], found["ny"], found["nz"]], axis=1)
    if viewpoint is None:
        return normals
    place = np.asarray(viewpoint, dtype=np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise DataError(f"viewpoint must be three finite coordinates, got {viewpoint!r}")
    away = ((place - points) * normals).sum(axis=1) < 0
    return np.where(away[:, None], -normals, normals)
