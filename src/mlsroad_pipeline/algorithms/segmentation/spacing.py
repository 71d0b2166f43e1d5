"""Euclidean clusters with a clustering distance that follows the spacing of the points."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.cell_grid import CELLS_PER_RADIUS, build_cell_grids
from mlsroad_pipeline.algorithms.geometry.cell_windows import first_window, move_window
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components, find_root, join
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

_NEIGHBORS = 4  # spacing is the distance to the fourth nearest neighbour: two along a scan line, two across


def cluster_by_spacing(
    xyz: ArrayLike, *, tolerance: float, spacing_factor: float, max_tolerance: float
) -> NDArray[np.int32]:
    """Cluster points within `tolerance`, or within a larger distance where points are sparser.

    The points are thinned to voxels of half the tolerance. Two voxels are also joined when their distance is at most
    `spacing_factor` times the spacing at both, and at most `max_tolerance`. The spacing of a voxel is the distance to
    its fourth nearest neighbour.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates, metres.
    tolerance : float
        The clustering distance where points are dense, metres.
    spacing_factor : float
        Clustering distance in units of the spacing. 0 uses the tolerance everywhere; larger joins sparse objects, and
        also objects close to them.
    max_tolerance : float
        Upper limit of the clustering distance, metres; values up to the tolerance disable the use of spacing.

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
    if len(sparse) == 0:
        return labels
    first = np.unique(grid.voxel_of_point, return_index=True)[1]  # a voxel belongs to the cluster of its first point
    parent = np.arange(int(labels.max()) + 1, dtype=np.int32)
    _join_reached(
        places[sparse], np.minimum(reach[sparse], max_tolerance), labels[first[sparse]], max_tolerance, parent
    )
    joined = connected_components(np.column_stack([np.arange(len(parent)), parent]), n_nodes=len(parent))
    return joined[labels]


def _join_reached(
    places: NDArray[np.float64],
    reach: NDArray[np.float64],
    owner: NDArray[np.int32],
    longest: float,
    parent: NDArray[np.int32],
) -> None:
    """Join clusters that own two places within the reach of both, in the union-find forest `parent`."""
    width = CELLS_PER_RADIUS
    # A cell one part in a billion wider: rounding cannot put a neighbour one cell farther away.
    cells = build_cell_grids(places, cell_size=longest * (1 + 1e-9) / width, margin=width)[0]
    rows = cells.row_offsets(width)
    _join_cells(places, reach, owner, cells.order, cells.keys, cells.starts, rows, width, parent)


@njit(cache=True, nogil=True)
def _join_cells(
    places: NDArray[np.float64],
    reach: NDArray[np.float64],
    owner: NDArray[np.int32],
    order: NDArray[np.int32],
    keys: NDArray[np.int64],
    starts: NDArray[np.int64],
    rows: NDArray[np.int64],
    width: int,
    parent: NDArray[np.int32],
) -> None:
    """Join clusters in `parent` cell by cell; a list of pairs would need gigabytes for a million places."""
    begin, end = first_window(keys, keys[0], rows, width)
    for cell in range(len(keys)):
        move_window(keys, keys[cell], rows, width, begin, end)
        for i in range(starts[cell], starts[cell + 1]):
            p = order[i]
            for j in range(len(rows)):
                for k in range(starts[begin[j]], starts[end[j]]):
                    q = order[k]
                    if q <= p or find_root(parent, owner[p]) == find_root(parent, owner[q]):
                        continue
                    dx, dy, dz = places[p, 0] - places[q, 0], places[p, 1] - places[q, 1], places[p, 2] - places[q, 2]
                    if np.sqrt(dx * dx + dy * dy + dz * dz) <= min(reach[p], reach[q]):
                        join(parent, owner[p], owner[q])
