"""Two-step segmentation of ordered scans: along each scan line, then across lines (after Zhou et al. 2014).

Yu et al. 2016 compare their segmentation with it (section V-B). The article, "A fast and accurate segmentation method
for ordered LiDAR point cloud of large-scale scenes", was not available; docs/methods/segmentation.md lists the
assumptions.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.geometry.neighbors import radius_neighbors
from mlsroad_pipeline.algorithms.segmentation.euclidean import number_objects

_CHUNK = 100_000  # places whose neighbours are in memory at a time; each has some hundreds


@dataclass(frozen=True)
class TwoStepParameters:
    """Parameters of the segmentation along and across scan lines."""

    along: float = 0.3  # m, longest step between consecutive returns of a run; larger bridges gaps, joins neighbours
    across: float = 0.3  # m, distance within which places of two runs touch
    contact: float = 0.25  # share of the places of the shorter run that must touch the other for a join, 0 to 1
    voxel_size: float = 0.1  # m, a run is thinned to one place per voxel of this edge

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
    """Segment off-ground points, m, into objects along and across scan lines; -1 below `min_points`.

    Consecutive returns of one scanner at short distances form a run. Two runs are joined when a sufficient share of the
    shorter one touches the other.
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
    """Return the pairs of runs that touch over a sufficient share of the shorter one; a place touches a run once."""
    n_runs = int(of_run.max()) + 1
    keys, counts = [], []
    for first in range(0, len(places), _CHUNK):
        near = radius_neighbors(places, radius=parameters.across, queries=places[first : first + _CHUNK])
        own, other = _touched_runs(*near, of_run, first)
        key, count = np.unique(own * n_runs + other, return_counts=True)
        keys.append(key)
        counts.append(count)
    pairs, of_pair = np.unique(np.concatenate(keys), return_inverse=True)
    touched = np.bincount(of_pair, np.concatenate(counts), minlength=len(pairs))
    own, other, size = pairs // n_runs, pairs % n_runs, np.bincount(of_run)
    # Of two equally long runs either may count as the shorter one.
    good = (size[own] <= size[other]) & (touched >= parameters.contact * size[own])
    return np.column_stack([own, other])[good]


@njit(cache=True, nogil=True)
def _touched_runs(
    indices: NDArray[np.int32], indptr: NDArray[np.int64], of_run: NDArray[np.int64], first: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the run of a place and another run, once for each place from `first` on and each run that it touches."""
    seen = np.full(of_run.max() + 1, -1, np.int64)
    own, other, n = np.empty(len(indices), np.int64), np.empty(len(indices), np.int64), 0
    for p in range(len(indptr) - 1):
        for k in range(indptr[p], indptr[p + 1]):
            run = of_run[indices[k]]
            if run != of_run[first + p] and seen[run] != p:
                seen[run] = p
                own[n], other[n] = of_run[first + p], run
                n += 1
    return own[:n], other[:n]
