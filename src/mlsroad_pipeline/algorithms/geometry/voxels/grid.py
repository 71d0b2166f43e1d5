"""Voxel grid: voxels of points, voxel centroids and voxel adjacency."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.geometry.cells import build_table, checked_bounds
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_ranges
from mlsroad_pipeline.algorithms.geometry.voxels import _bricks, _lookup


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Points sorted into the occupied voxels of a regular grid.

    Voxels are numbered by position: brick by brick (8 x 8 x 8 voxels, sorted by x, y and z), and by x, y and z within a
    brick. Voxels that are close in space are thus mostly close in memory.
    """

    voxel_size: float  # Edge of a voxel, metres
    origin: NDArray[np.float64]  # Minimum corner of voxel (0, 0, 0) in the coordinates of the points, metres
    voxel_of_point: NDArray[np.int32]  # Voxel of each point
    coords: NDArray[np.int32]  # Integer coordinates of each voxel, at least 0
    counts: NDArray[np.int32]  # Points in each voxel, at least 1
    # Mean of the points of each voxel, in voxel sizes from `origin`, exact to 2^-20 of a voxel
    local_centroids: NDArray[np.float64]
    _keys: NDArray[np.int64]
    _bitmaps: NDArray[np.uint64]
    _first: NDArray[np.int32]

    def __len__(self) -> int:
        """Return the number of occupied voxels."""
        return len(self.coords)

    @cached_property
    def centroids(self) -> NDArray[np.float64]:
        """Mean of the points of each voxel, (v, 3) float64, metres in the coordinates of the points."""
        return self.origin + self.local_centroids * self.voxel_size

    @cached_property
    def indptr(self) -> NDArray[np.int64]:
        """Start of each voxel in `order`, (v + 1,) int64."""
        return np.concatenate([np.zeros(1, np.int64), np.cumsum(self.counts, dtype=np.int64)])

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """Point indices sorted by voxel, ascending within a voxel, (n,) int64."""
        return _bricks.sort_points(self.voxel_of_point, self.indptr)

    @cached_property
    def _table(self) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        return build_table(self._keys)

    def find(self, coords: ArrayLike) -> NDArray[np.int32]:
        """Return the voxels at integer coordinates."""
        triples = np.asarray(coords)
        if triples.ndim != 2 or triples.shape[1] != 3 or not np.issubdtype(triples.dtype, np.integer):
            raise DataError(f"coords must be integers of shape (m, 3), got {triples.dtype} {triples.shape}")
        slots, values = self._table
        return _lookup.look_up_voxels(triples.astype(np.int64), slots, values, self._bitmaps, self._first)

    def neighbors(self, *, n_threads: int = 1) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Return the occupied 26-neighbours of each voxel as a CSR pair."""
        slots, values = self._table
        n_bricks = len(self._keys)

        def work(start: int, stop: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
            v_start = self._first[start, 0] if start < n_bricks else len(self)
            v_stop = self._first[stop, 0] if stop < n_bricks else len(self)
            return _lookup.neighbor_rows(
                self._keys, slots, values, self._bitmaps, self._first, start, stop, v_start, v_stop
            )

        parts = run_ranges(work, n_bricks, check_threads(n_threads))
        if len(parts) == 1:
            return parts[0]
        shifts = np.cumsum([0] + [len(indices) for _, indices in parts])
        indptr = [parts[0][0][:1]] + [part[0][1:] + shift for part, shift in zip(parts, shifts, strict=False)]
        return np.concatenate(indptr), np.concatenate([indices for _, indices in parts])


def build_voxel_grid(
    xyz: ArrayLike, *, voxel_size: float, anchor: ArrayLike | None = None, n_threads: int = 1
) -> VoxelGrid:
    """Sort points into the voxels of a regular grid.

    The function reads the points twice and needs 4 bytes per point and about 60 bytes per voxel. A point on the face
    between two voxels belongs to the upper one.
    """
    size = check_positive(voxel_size, "voxel_size")
    threads = check_threads(n_threads)
    points, low, high = checked_bounds(xyz, n_threads=threads, minimum=1)
    origin = _anchored_origin(low, (low + high) / 2 if anchor is None else anchor, size)
    longest = float((high - origin).max()) / size
    if longest >= 1 << (_bricks.AXIS_BITS + 3):
        raise ParameterError(f"voxel_size {voxel_size!r} is too small for a cloud {longest * size:.6g} m long")
    codes = np.empty(len(points), np.int32)
    scale = (1 << _bricks.FRACTION_BITS) / size
    parts = run_ranges(
        lambda start, stop: _bricks.assign_bricks(points, origin, scale, start, stop, codes), len(points), threads
    )
    keys = np.unique(np.concatenate([part[0] for part in parts]))
    if len(keys) > 1 << 22:
        raise ParameterError(f"voxel_size {voxel_size!r} gives {len(keys)} occupied bricks of voxels, more than 2^22")
    bitmaps = np.zeros((len(keys), 8), np.uint64)
    positions = [np.searchsorted(keys, part[0]).astype(np.int32) for part in parts]
    for part, position in zip(parts, positions, strict=True):
        _bricks.merge_bitmaps(bitmaps, part[1], position)
    first, coords = _bricks.number_voxels(keys, bitmaps)
    sums = _sum_points(points, origin, scale, positions, bitmaps, first, codes, len(coords))
    local = _bricks.local_centroids(coords, sums)
    return VoxelGrid(size, origin, codes, coords, sums[:, 3].astype(np.int32), local, keys, bitmaps, first)


def _anchored_origin(low: NDArray[np.float64], anchor: ArrayLike, size: float) -> NDArray[np.float64]:
    """Return the corner of the anchored grid at or below the minimum corner of the points."""
    corner = np.asarray(anchor, dtype=np.float64)
    if corner.shape != (3,) or not np.isfinite(corner).all():
        raise DataError(f"anchor must be three finite coordinates, got {anchor!r}")
    origin = corner + np.floor((low - corner) / size) * size
    return np.where(origin > low, origin - size, origin)


def _sum_points(
    points: NDArray[np.floating],
    origin: NDArray[np.float64],
    scale: float,
    positions: list[NDArray[np.int32]],
    bitmaps: NDArray[np.uint64],
    first: NDArray[np.int32],
    codes: NDArray[np.int32],
    n_voxels: int,
) -> NDArray[np.int64]:
    """Replace codes by voxel ids in place; return the integer sums of each voxel."""
    n_threads = len(positions)

    def work(start: int, stop: int) -> NDArray[np.int64]:
        position = positions[next(k for k in range(n_threads) if len(points) * (k + 1) // n_threads >= stop)]
        sums = np.zeros((n_voxels, 4), np.int64)
        _bricks.accumulate_points(points, origin, scale, start, stop, position, bitmaps, first, codes, sums)
        return sums

    parts = run_ranges(work, len(points), n_threads)
    total: NDArray[np.int64] = parts[0]
    for part in parts[1:]:
        total += part
    return total
