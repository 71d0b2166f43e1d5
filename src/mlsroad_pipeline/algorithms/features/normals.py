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

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    radius : float, optional
        Radius of the neighbourhood in metres. Larger values reduce noise and round off edges.
    k : int, optional
        Number of nearest points of the neighbourhood, including the point itself. Give exactly one of `radius` and `k`.
    viewpoint : array-like of shape (3,), optional
        Position that all normals face, metres. By default they point upwards (nz >= 0); on vertical surfaces, their
        sign is then arbitrary.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of float32, shape (n, 3)
        Unit normals; NaN for neighbourhoods of fewer than three or of collinear points.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) and finite, its extent is too large for the radius, or `viewpoint` is not three finite
        numbers.
    ParameterError
        If not exactly one of `radius` and `k` is given, `radius` is not positive, or `k` or `n_threads` is below 1.
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
