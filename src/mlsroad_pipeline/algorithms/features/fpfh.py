"""Fast point feature histograms (Rusu et al. 2009)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.fpfh_kernels import simple_histograms, weighted_histograms
from mlsroad_pipeline.algorithms.geometry.cells import build_cell_grids
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_in_chunks

_MAX_BINS = 255
_REACH = 1
"""Cells per radius: vectorised distance tests cost less than gathering points for smaller cells."""


def compute_fpfh(
    xyz: ArrayLike,
    normals: ArrayLike,
    *,
    radius: float,
    n_bins: int = 11,
    use_distance: bool = False,
    n_threads: int = 1,
) -> NDArray[np.float32]:
    """Compute the fast point feature histogram of each point.

    For a point and each neighbour, three angles are computed in a frame defined by the normal of one of the two (Rusu
    et al. 2009, equation 1: theta, alpha, phi) and counted in bins: the simplified histogram (SPFH). The histogram of a
    point is the average, feature by feature, of its own SPFH and of the mean SPFH of its neighbours, weighted by the
    inverse square of the distance. Weights and bins are those of Open3D's ``compute_fpfh_feature``, whose histograms
    sum to 200 per feature; these sum to 1 in total. Memory is about twice that of the result.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Points in metres.
    normals : array-like of shape (n, 3)
        Unit normals. Points without a finite normal are excluded; their histogram is 0.
    radius : float
        Search radius in metres, inclusive; should exceed that of the normals. On surfaces, time grows quadratically.
    n_bins : int, default 11
        Bins of each feature, 1 to 255 (Rusu et al.: 11).
    use_distance : bool, default False
        Whether to use the distance, from 0 to `radius`, as a fourth feature.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    ndarray of float32, shape (n, 3 * n_bins) or (n, 4 * n_bins)
        Histograms in the order theta (the angle about the axis of the frame), alpha, phi and distance. Each row sums to
        1, or to 0 without neighbours.

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
    # Slightly wider cells: a neighbour whose float32 distance rounds down to the radius must be in reach.
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
