"""Euclidean clusters: connected components of the graph that joins points within a distance, and their numbering.

Points are sorted once into cells of edge ``tolerance / sqrt(3)``. Points of one cell are never farther apart than the
tolerance, so a cell is one node. Two nearby cells touch if a pair of their points is close enough; cells that are
joined already are not tested. Cells that may touch lie within two cells along each axis. As the cells are sorted by x
fastest, the up to five candidates of one (y, z) offset are consecutive, and one forward pointer per offset finds them
without a search.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.cells import (
    CELLS_PER_RADIUS,
    bounding_box,
    build_cell_grids,
    cell_keys,
    first_window,
    move_window,
)
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components, find_root, join
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid

_MAX_KEY = 2.0**62
# Row offsets (dy, dz) of the half space that follows a cell in key order, nearest first: once near cells are joined,
# most of the far ones need no point test.
_ROWS = np.array(
    sorted(
        [(dy, dz) for dz in range(3) for dy in range(-2, 3) if (dz, dy) > (0, 0)],
        key=lambda row: (row[0] ** 2 + row[1] ** 2, row),
    ),
    dtype=np.int64,
)
_NEIGHBORS = 4  # spacing is the distance to the fourth nearest neighbour: two along a scan line, two across


@njit(cache=True)
def _cells(
    keys: NDArray[np.int64], order: NDArray[np.int32], xyz: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray]:
    """Return keys, first points and bounding boxes of the occupied cells, and the points in cell order."""
    n = len(keys)
    n_cells = 1
    for i in range(1, n):
        n_cells += keys[i] != keys[i - 1]
    cell_key = np.empty(n_cells, np.int64)
    start = np.empty(n_cells + 1, np.int64)
    box = np.empty((n_cells, 6), np.float64)
    points = np.empty((n, 3), xyz.dtype)
    cell = -1
    for i in range(n):
        if i == 0 or keys[i] != keys[i - 1]:
            cell += 1
            cell_key[cell], start[cell] = keys[i], i
            box[cell, :3], box[cell, 3:] = np.inf, -np.inf
        for axis in range(3):
            points[i, axis] = xyz[order[i], axis]
            value = np.float64(xyz[order[i], axis])
            box[cell, axis] = min(box[cell, axis], value)
            box[cell, 3 + axis] = max(box[cell, 3 + axis], value)
    start[n_cells] = n
    return cell_key, start, box, points


@njit(cache=True)
def _touch(a: int, b: int, start: NDArray[np.int64], box: NDArray[np.float64], points: NDArray, limit: float) -> bool:
    """Return whether a point of cell a and a point of cell b lie within the tolerance (limit is its square)."""
    gap = 0.0
    for axis in range(3):
        between = max(box[b, axis] - box[a, 3 + axis], box[a, axis] - box[b, 3 + axis], 0.0)
        gap += between * between
    if gap > limit * (1 + 1e-12):
        return False
    for i in range(start[a], start[a + 1]):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        gx = max(box[b, 0] - x, x - box[b, 3], 0.0)
        gy = max(box[b, 1] - y, y - box[b, 4], 0.0)
        gz = max(box[b, 2] - z, z - box[b, 5], 0.0)
        if gx * gx + gy * gy + gz * gz > limit * (1 + 1e-12):
            continue
        for j in range(start[b], start[b + 1]):
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            if dx * dx + dy * dy + dz * dz <= limit:
                return True
    return False


@njit(cache=True)
def _link_cells(
    cell_key: NDArray[np.int64], start: NDArray[np.int64], box: NDArray[np.float64], points: NDArray,
    shape: NDArray[np.int64], rows: NDArray[np.int64], limit: float,
) -> NDArray[np.int32]:  # fmt: skip
    n_cells = len(cell_key)
    parent = np.arange(n_cells).astype(np.int32)
    for a in range(n_cells):  # the row of the cell itself
        for b in range(a + 1, min(a + 3, n_cells)):
            if cell_key[b] - cell_key[a] <= 2 and _touch(a, b, start, box, points, limit):
                join(parent, a, b)
    for row in range(len(rows)):
        shift = shape[0] * (rows[row, 0] + shape[1] * rows[row, 1])
        first = 0
        for a in range(n_cells):
            target = cell_key[a] + shift
            while first < n_cells and cell_key[first] < target - 2:
                first += 1
            b = first
            while b < n_cells and cell_key[b] <= target + 2:
                if find_root(parent, a) != find_root(parent, b) and _touch(a, b, start, box, points, limit):
                    join(parent, a, b)
                b += 1
    return parent


@njit(cache=True)
def _roots(parent: NDArray[np.int32], start: NDArray[np.int64], order: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the first cell of each point's component."""
    roots = np.empty(len(order), np.int32)
    for cell in range(len(parent)):
        root = find_root(parent, cell)
        for i in range(start[cell], start[cell + 1]):
            roots[order[i]] = root
    return roots


def number_objects(parts: NDArray[np.integer], min_points: int) -> NDArray[np.int32]:
    """Number parts, at least 0, as 0, 1, ... by their first points; parts of fewer than `min_points` become -1."""
    check_at_least(min_points, 1, "min_points")
    return np.zeros(0, np.int32) if len(parts) == 0 else _numbered(parts, min_points)


@njit(cache=True, nogil=True)
def _numbered(parts: NDArray[np.integer], min_points: int) -> NDArray[np.int32]:
    n_parts = 0
    for part in parts:
        n_parts = max(n_parts, part + 1)
    counts = np.zeros(n_parts, np.int64)
    for part in parts:
        counts[part] += 1
    number = np.full(len(counts), -1, np.int32)
    out = np.empty(len(parts), np.int32)
    n_objects = 0
    for i in range(len(parts)):
        part = parts[i]
        if counts[part] < min_points:
            out[i] = -1
            continue
        if number[part] < 0:
            number[part] = n_objects
            n_objects += 1
        out[i] = number[part]
    return out


def number_pairs(a: NDArray[np.integer], b: NDArray[np.integer]) -> NDArray[np.int64]:
    """Number the distinct pairs of two non-negative integers, such as voxel and cluster, in ascending order."""
    return np.unique(a.astype(np.int64) * (int(b.max()) + 1) + b, return_inverse=True)[1].astype(np.int64)


def cluster(xyz: ArrayLike, *, tolerance: float, min_points: int = 1) -> NDArray[np.int32]:
    """Label the connected components of points within a distance of `tolerance`.

    Distances are computed in float64 and include the tolerance. The time is linear in the points, except for dense
    cells whose points are just too far apart.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates, metres. Float64 keeps world coordinates exact.
    tolerance : float
        The longest step within a cluster, metres. Larger values join neighbouring objects, smaller values split objects
        where points are sparse; 0.1 to 0.5 m suit street objects.
    min_points : int, default 1
        Clusters with fewer points are labelled -1.

    Returns
    -------
    ndarray of int32, shape (n,)
        Labels 0, 1, ... numbered by each kept cluster's first point; -1 in clusters below `min_points`.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3), holds NaN or infinite coordinates, has 2**31 points or more, or spans so many tolerances
        that cells cannot be numbered in 62 bits.
    ParameterError
        If `tolerance` is not a finite number above zero or `min_points` is below 1.

    Examples
    --------
    >>> cluster([[0, 0, 0], [5, 0, 0], [0.1, 0, 0]], tolerance=0.2).tolist()
    [0, 1, 0]
    """
    array = check_xyz(xyz)
    check_positive(tolerance, "tolerance")
    check_at_least(min_points, 1, "min_points")
    if len(array) == 0:
        return np.zeros(0, dtype=np.int32)
    if len(array) >= 2**31:
        raise DataError(f"cluster works on fewer than 2**31 points, got {len(array)}: cut the survey into scenes")
    low, high = bounding_box(array)
    extent = high - low
    # Cells slightly smaller than tolerance / sqrt(3): rounding must not put points of one cell beyond the tolerance.
    inverse = float(np.sqrt(3.0) * (1 + 1e-9) / tolerance)
    # Two empty cells of margin per axis: a neighbour beyond the border must not wrap around into the next row.
    size = np.floor(extent * inverse) + 3.0
    if float(np.prod(size)) >= _MAX_KEY:
        raise DataError(f"points span {extent.tolist()} m, too many cells for a tolerance of {tolerance} m")
    shape = size.astype(np.int64)
    keys, order = radix_argsort(cell_keys(array, low, inverse, shape[0], shape[1], 0), int(np.prod(size)).bit_length())
    cell_key, start, box, points = _cells(keys, order, array)
    parent = _link_cells(cell_key, start, box, points, shape, _ROWS, float(tolerance) ** 2)
    return _numbered(_roots(parent, start, order), min_points)


def cluster_by_spacing(
    xyz: ArrayLike, *, tolerance: float, spacing_factor: float, max_tolerance: float
) -> NDArray[np.int32]:
    """Cluster points within `tolerance`, or up to `max_tolerance` where they are sparser; lengths in metres.

    Voxels of half the tolerance are also joined within `spacing_factor` times the spacing at both, the distance to the
    fourth nearest voxel. A factor of 0, or a `max_tolerance` up to the tolerance, disables this.
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
    # A cell one part in a billion wider: rounding cannot put a neighbour one cell farther away.
    size, width = max_tolerance * (1 + 1e-9) / CELLS_PER_RADIUS, CELLS_PER_RADIUS
    cells = build_cell_grids(places[sparse], cell_size=size, margin=width)[0]
    _join_cells(
        places[sparse], np.minimum(reach[sparse], max_tolerance), labels[first[sparse]], cells.order, cells.keys,
        cells.starts, cells.row_offsets(width), width, parent,
    )  # fmt: skip
    joined = connected_components(np.column_stack([np.arange(len(parent)), parent]), n_nodes=len(parent))
    return joined[labels]


@njit(cache=True, nogil=True)
def _join_cells(
    places: NDArray[np.float64], reach: NDArray[np.float64], owner: NDArray[np.int32], order: NDArray[np.int32],
    keys: NDArray[np.int64], starts: NDArray[np.int64], rows: NDArray[np.int64], width: int, parent: NDArray[np.int32],
) -> None:  # fmt: skip
    """Join, in the union-find forest `parent`, the clusters that own two places within the reach of both.

    It works cell by cell; a list of pairs would need gigabytes for a million places.
    """
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
