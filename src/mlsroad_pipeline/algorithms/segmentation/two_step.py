"""Two-step segmentation of ordered scans: along each scan line, then across lines (after Zhou et al. 2014).

Yu et al. 2016 compare their segmentation with it (section V-B). The article, "A fast and accurate segmentation method
for ordered LiDAR point cloud of large-scale scenes", was not available; docs/methods/segmentation.md lists the
assumptions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.cell_grid import CELLS_PER_RADIUS, build_cell_grids
from mlsroad_pipeline.algorithms.geometry.cell_windows import first_window, move_window
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation.numbering import number_objects


@dataclass(frozen=True)
class TwoStepParameters:
    """Parameters of the segmentation along and across scan lines.

    Parameters
    ----------
    along : float, default 0.3
        The longest step between consecutive returns of a run, metres. Larger runs bridge gaps and join neighbours.
    across : float, default 0.3
        Distance within which places of two runs touch, metres.
    contact : float, default 0.25
        Share of the places of the shorter run that must touch the other for the two to be joined, 0 to 1. Larger
        separates objects that touch only at their edges.
    voxel_size : float, default 0.1
        A run is thinned to one place per voxel of this edge, metres.

    Raises
    ------
    ParameterError
        If a length is not positive or `contact` is not in [0, 1].
    """

    along: float = 0.3
    across: float = 0.3
    contact: float = 0.25
    voxel_size: float = 0.1

    def __post_init__(self) -> None:
        for name in ("along", "across", "voxel_size"):
            check_positive(getattr(self, name), f"two_step.{name}")
        if not 0 <= self.contact <= 1:
            raise ParameterError(f"two_step.contact must be between 0 and 1, got {self.contact!r}")


def segment_two_step(
    xyz: ArrayLike,
    *,
    gps_time: ArrayLike,
    scanner: ArrayLike,
    parameters: TwoStepParameters = TwoStepParameters(),
    min_points: int = 1,
) -> NDArray[np.int32]:
    """Segment off-ground points into objects along and across scan lines.

    Consecutive returns of one scanner at short distances form a run. Two runs are joined when a sufficient share of the
    shorter one touches the other.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates without the ground, metres.
    gps_time : array-like of shape (n,)
        Time of each return, seconds.
    scanner : array-like of shape (n,), integer
        Scanner of each return.
    parameters : TwoStepParameters
        Distances and share of contact.
    min_points : int, default 1
        Objects with fewer points are labelled -1.

    Returns
    -------
    ndarray of int32, shape (n,)
        Objects 0, 1, ... numbered by their first points; -1 below `min_points`.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite, or a column has another length.
    ParameterError
        If `min_points` is below 1.
    """
    points = check_xyz(xyz).astype(np.float64, copy=False)
    times = check_column(gps_time, len(points), "gps_time")
    devices = check_column(scanner, len(points), "scanner")
    if len(points) == 0:
        return number_objects(np.zeros(0, np.int64), min_points)
    runs = _runs(points, times, devices, parameters.along)
    places, of_run = _thinned(points, runs, parameters.voxel_size)
    pairs = _touching(places, of_run, parameters)
    joined = connected_components(pairs, n_nodes=int(runs.max()) + 1)
    return number_objects(joined[runs].astype(np.int64), min_points)


def _runs(points: NDArray[np.float64], times: NDArray, devices: NDArray, along: float) -> NDArray[np.int64]:
    """Number the runs of consecutive returns of a scanner at short distances; returns of one pulse by position."""
    order = np.lexsort((points[:, 2], points[:, 1], points[:, 0], times, devices))
    step = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
    new = np.concatenate([[True], (step > along) | (np.diff(devices[order]) != 0)])
    runs = np.empty(len(points), np.int64)
    runs[order] = np.cumsum(new) - 1
    return runs


def _thinned(
    points: NDArray[np.float64], runs: NDArray[np.int64], size: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the mean places of each run in its voxels, and the run of each place."""
    cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    order = np.lexsort((points[:, 2], points[:, 1], points[:, 0], cells[:, 2], cells[:, 1], cells[:, 0], runs))
    key = np.column_stack([runs, cells])[order]
    starts = np.flatnonzero(np.concatenate([[True], (np.diff(key, axis=0) != 0).any(axis=1)]))
    counts = np.diff(np.append(starts, len(points)))
    return np.add.reduceat(points[order], starts, axis=0) / counts[:, None], key[starts, 0]


def _touching(places: NDArray[np.float64], of_run: NDArray[np.int64], parameters: TwoStepParameters) -> NDArray:
    """Return the pairs of runs that touch over a sufficient share."""
    size = parameters.across * (1 + 1e-9) / CELLS_PER_RADIUS  # rounding cannot put a neighbour a cell too far
    grid = build_cell_grids(places, cell_size=size, margin=CELLS_PER_RADIUS)[0]
    rows = grid.row_offsets(CELLS_PER_RADIUS)
    begin, end = _windows(grid.keys, rows, CELLS_PER_RADIUS)
    bounds = np.searchsorted(of_run, np.arange(int(of_run.max()) + 2))
    return np.asarray(
        _side_by_side(
            places, grid.order, grid.starts, begin, end, of_run, bounds, parameters.across, parameters.contact
        )
    )


@njit(cache=True, nogil=True)
def _windows(keys: NDArray[np.int64], rows: NDArray[np.int64], reach: int) -> tuple[NDArray, NDArray]:
    """Return where each row of cells around each occupied cell begins and ends among the occupied ones."""
    begins, ends = np.empty((len(keys), len(rows)), np.int32), np.empty((len(keys), len(rows)), np.int32)
    begin, end = first_window(keys, keys[0], rows, reach)
    for cell in range(len(keys)):
        move_window(keys, keys[cell], rows, reach, begin, end)
        begins[cell], ends[cell] = begin, end
    return begins, ends


@njit(cache=True, nogil=True)
def _side_by_side(
    places: NDArray[np.float64],
    order: NDArray[np.int32],
    starts: NDArray[np.int64],
    begins: NDArray[np.int32],
    ends: NDArray[np.int32],
    of_run: NDArray[np.int64],
    bounds: NDArray[np.int64],
    across: float,
    contact: float,
) -> NDArray[np.int64]:
    """Count, run by run, the places of a run that each other run touches; a place touches a run once."""
    n_runs = len(bounds) - 1
    cell_of = np.empty(len(places), np.int32)
    for cell in range(len(starts) - 1):
        for i in range(starts[cell], starts[cell + 1]):
            cell_of[order[i]] = cell
    count, seen = np.zeros(n_runs, np.int64), np.full(n_runs, -1, np.int64)
    touched = np.empty(n_runs, np.int64)
    pairs, n_pairs = np.empty((1024, 2), np.int64), 0
    for run in range(n_runs):
        n_touched, size = 0, bounds[run + 1] - bounds[run]
        for p in range(bounds[run], bounds[run + 1]):
            near, far = begins[cell_of[p]], ends[cell_of[p]]
            n_touched = _touch(places, p, order, starts, near, far, of_run, across, count, seen, touched, n_touched)
        for k in range(n_touched):
            other = touched[k]
            # Of two equally long runs either may count as the shorter one.
            if size <= bounds[other + 1] - bounds[other] and count[other] >= contact * size:
                if n_pairs == len(pairs):
                    pairs = np.concatenate((pairs, np.empty_like(pairs)))
                pairs[n_pairs, 0], pairs[n_pairs, 1] = run, other
                n_pairs += 1
            count[other] = 0
    return pairs[:n_pairs]


@njit(cache=True, nogil=True)
def _touch(
    places: NDArray[np.float64], p: int, order: NDArray[np.int32], starts: NDArray[np.int64], begin: NDArray[np.int32],
    end: NDArray[np.int32], of_run: NDArray[np.int64], across: float, count: NDArray[np.int64],
    seen: NDArray[np.int64], touched: NDArray[np.int64], n_touched: int,
) -> int:  # fmt: skip
    """Count a place for each other run that it touches; return the number of runs touched so far."""
    for j in range(len(begin)):
        for i in range(starts[begin[j]], starts[end[j]]):
            q = order[i]
            other = of_run[q]
            if other == of_run[p] or seen[other] == p:
                continue
            away = 0.0
            for axis in range(3):
                away += (places[p, axis] - places[q, axis]) ** 2
            if away <= across * across:
                seen[other] = p
                if count[other] == 0:
                    touched[n_touched] = other
                    n_touched += 1
                count[other] += 1
    return n_touched
