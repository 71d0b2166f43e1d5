"""Euclidean clusters whose clustering distance follows the points' spacing: far from the scanner points lie apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.voxels.grid import build_voxel_grid

_NEIGHBORS = 4  # the spacing of a place is the distance to its fourth nearest: two along a scan line, two across


def cluster_by_spacing(
    xyz: ArrayLike, *, tolerance: float, spacing_factor: float, max_tolerance: float
) -> NDArray[np.int32]:
    """Group points into clusters with steps of at most `tolerance`, longer ones where points lie farther apart.

    The points are thinned to voxels of half the tolerance. Two of them are also joined when their distance is at most
    `spacing_factor` times the spacing at either, the distance to its fourth nearest, and at most `max_tolerance`.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates, metres.
    tolerance : float
        The clustering distance where points are dense, metres.
    spacing_factor : float
        Steps in units of the spacing. 0 keeps to the tolerance everywhere; larger joins sparse objects, and what stands
        close to them.
    max_tolerance : float
        The longest step that spacing leads to, metres; at the tolerance and below spacing changes nothing.

    Returns
    -------
    ndarray of int32, shape (n,)
        Labels numbered by each cluster's first point.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite.
    ParameterError
        If a length is not positive or the factor negative.
    """
    points = check_xyz(xyz)
    if not 0 <= spacing_factor < np.inf:
        raise ParameterError(f"spacing_factor must be at least 0, got {spacing_factor!r}")
    check_positive(max_tolerance, "max_tolerance")
    labels = cluster(points, tolerance=tolerance)
    if len(points) <= _NEIGHBORS or spacing_factor == 0 or max_tolerance <= tolerance:
        return labels
    grid = build_voxel_grid(points, voxel_size=0.5 * tolerance)
    places = grid.centroids
    if len(places) <= _NEIGHBORS:
        return labels
    reach = spacing_factor * cKDTree(places).query(places, k=_NEIGHBORS + 1)[0][:, -1]
    sparse = np.flatnonzero(reach > tolerance)
    reach = np.minimum(reach[sparse], max_tolerance)
    pairs = cKDTree(places[sparse]).query_pairs(max_tolerance, output_type="ndarray")
    step = np.linalg.norm(places[sparse[pairs[:, 0]]] - places[sparse[pairs[:, 1]]], axis=1)
    pairs = pairs[step <= np.minimum(reach[pairs[:, 0]], reach[pairs[:, 1]])]
    first = np.unique(grid.voxel_of_point, return_index=True)[1]  # a voxel of two clusters speaks for its first point
    joined = connected_components(labels[first[sparse[pairs]]], n_nodes=int(labels.max()) + 1)
    return joined[labels]
