"""Fast point feature histograms (Rusu et al. 2009): how normals lie to each other around every point."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.fpfh_kernels import simple_histograms, weighted_histograms
from mlsroad_pipeline.algorithms.geometry.cell_grid import build_cell_grids, check_threads, run_in_chunks

_MAX_BINS = 255
_REACH = 1
"""Cells along the radius: tests of distances vectorise and cost less here than gathering for smaller cells."""


def compute_fpfh(
    xyz: ArrayLike,
    normals: ArrayLike,
    *,
    radius: float,
    n_bins: int = 11,
    use_distance: bool = False,
    n_threads: int = 1,
) -> NDArray[np.float32]:
    """Describe the shape around every point by how the normals of its neighbours lie to each other.

    For a point and each neighbour, three angles are taken in a frame that the normal of one of the two spans (Rusu et
    al. 2009, equation 1: theta, alpha, phi) and counted in bins: the simplified histogram (SPFH). A point's histogram
    is its own SPFH and the mean of its neighbours', each weighted by the inverse square of its distance, in equal
    shares, feature by feature. Weights and bins are those of Open3D's ``compute_fpfh_feature``, whose histograms sum
    to 200 per feature where these sum to 1 in all. Memory is about twice that of the result.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    normals : array-like of shape (n, 3)
        Unit normals. A point whose normal is not finite is nobody's neighbour, and its histogram is 0.
    radius : float
        How far neighbours are sought, metres; larger than what the normals were estimated from. A pair at exactly this
        distance counts. The time grows with its square on surfaces.
    n_bins : int, default 11
        Bins of each feature, 1 to 255 (Rusu et al.: 11).
    use_distance : bool, default False
        Whether the distance, from 0 to `radius`, is counted as a fourth feature.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of float32, shape (n, 3 * n_bins) or (n, 4 * n_bins)
        Histograms in the order theta (the angle about the frame's axis), alpha, phi and distance. Each row sums to 1,
        or to 0 for a point without any neighbour.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) and finite, `normals` has another shape, or the extent is too large for the radius.
    ParameterError
        If `radius` is not positive, `n_bins` is not from 1 to 255, or `n_threads` is below 1.
    """
    check_positive(radius, "radius")
    if not 1 <= n_bins <= _MAX_BINS:
        raise ParameterError(f"n_bins must be from 1 to {_MAX_BINS}, got {n_bins!r}")
    check_threads(n_threads)
    points = check_xyz(xyz)
    directions = check_column(normals, len(points), "normals", width=3)
    out = np.zeros((len(points), (4 if use_distance else 3) * n_bins), np.float32)
    known = np.flatnonzero(np.isfinite(directions).all(axis=1))
    if len(known) == 0:
        return out
    if len(known) < len(points):
        points, directions = points[known], directions[known]
    # Slightly wider cells: a neighbour whose distance float32 rounds down to the radius must be in reach.
    size = radius * (1 + 1e-6) / _REACH
    grid = build_cell_grids(points, cell_size=size, margin=_REACH)[0]
    rows = grid.row_offsets(_REACH)
    sorted_normals = np.ascontiguousarray(directions[grid.order].T, dtype=np.float32)
    simple = np.empty((len(points), out.shape[1]), np.float32)
    n_features = out.shape[1] // n_bins

    def count(first: int, last: int) -> None:
        simple_histograms(
            grid.local, sorted_normals, grid.keys, grid.starts, rows, _REACH, size, radius, n_bins, n_features,
            first, last, simple,
        )  # fmt: skip

    def weigh(first: int, last: int) -> None:
        weighted_histograms(
            grid.local, targets, grid.keys, grid.starts, rows, _REACH, size, radius, simple, n_bins, first, last, out
        )

    targets = known[grid.order].astype(np.int32)
    run_in_chunks(count, len(grid.keys), n_threads=n_threads)
    run_in_chunks(weigh, len(grid.keys), n_threads=n_threads)
    return out
