"""Seen space around places: voxels that rays of the scanner crossed, and voxels with points.

A ray goes from the scanner to a point. It proves that the voxels which it crosses up to `BEHIND` before its point are
empty. A place has `SIDE` x `SIDE` columns of voxels around its axis, from `LOW` above the ground upward.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

CELL, SLICE = 0.2, 0.25
"""Edge of a voxel in plan, and its height, metres."""
SIDE, SLICES = 8, 20
"""Number of voxels along the side of a place, and above each other."""
LOW = 0.3
"""Lower end of the voxels above the ground, metres: kerbs, grass and the noise of the ground lie below."""
BEHIND = 0.3
"""Distance before the end of a ray from which nothing is proved, metres."""
HALF = SIDE * CELL / 2
_GRID = 2.0  # edge of the cells that list the places, metres
_MOST_CELLS = 20_000_000
_MOST = np.iinfo(np.uint16).max
TREE = 3
"""Number of the kind of trees."""
LOW_VEGETATION, FURNITURE, NO_KIND = 253, 254, 255
"""Codes of points of low vegetation, which small trees are taken for, of street furniture, and of other classes."""


class SeenSpace(NamedTuple):
    """Counts of each place (n), slice, row and column of voxels."""

    free: NDArray[np.uint16]  # Rays that crossed the voxel, shape (n, SLICES, SIDE, SIDE)
    hit: NDArray[np.uint16]  # Points in the voxel
    own: NDArray[np.uint16]  # Points of the kind of the place
    other: NDArray[np.uint16]  # Points of other kinds of objects that stand upright
    rays: NDArray[np.int64]  # Rays that crossed any voxel of the place, shape (n,)

    @classmethod
    def unseen(cls, n: int) -> "SeenSpace":
        """Return the space of places that no ray has reached."""
        free, hit, own, other = np.zeros((4, n, SLICES, SIDE, SIDE), dtype=np.uint16)
        return cls(free, hit, own, other, np.zeros(n, dtype=np.int64))


class PlaceIndex(NamedTuple):
    """Places by cells in plan."""

    places: NDArray[np.float64]  # x, y of the axis and z of the ground, shape (n, 3)
    corner: NDArray[np.float64]  # x, y of the first cell
    edge: float
    shape: tuple[int, int]
    start: NDArray[np.int64]  # First entry of each cell in `rows`
    rows: NDArray[np.int32]


def index_places(places: NDArray[np.float64]) -> PlaceIndex:
    """Return places in cells; a place is listed in all cells that its voxels touch."""
    corner = places[:, :2].min(axis=0) - HALF
    extent = places[:, :2].max(axis=0) + HALF - corner
    edge = max(_GRID, float(np.sqrt(extent.prod() / _MOST_CELLS)))
    shape = tuple(int(n) for n in np.floor(extent / edge).astype(np.int64) + 1)
    cells, rows = [], []
    for dx in (-HALF, HALF):
        for dy in (-HALF, HALF):
            ij = np.floor((places[:, :2] + [dx, dy] - corner) / edge).astype(np.int64)
            ij = np.clip(ij, 0, np.array(shape) - 1)
            cells.append(ij[:, 0] * shape[1] + ij[:, 1])
            rows.append(np.arange(len(places)))
    pairs = np.unique(np.column_stack([np.concatenate(cells), np.concatenate(rows)]), axis=0)
    start = np.searchsorted(pairs[:, 0], np.arange(shape[0] * shape[1] + 1))
    return PlaceIndex(places, corner, edge, (shape[0], shape[1]), start, pairs[:, 1].astype(np.int32))


def add_rays(
    seen: SeenSpace,
    index: PlaceIndex,
    place_kind: NDArray[np.uint8],
    scanner: NDArray[np.float64],
    points: NDArray[np.float64],
    point_kind: NDArray[np.uint8],
) -> None:
    """Add rays from the scanner to points, each with the kind of its object or one of the codes, to the counts, in
    place.
    """
    grid = (index.start, index.rows, index.shape[0], index.shape[1], index.edge, *index.corner.tolist())
    _add_rays(index.places, grid, place_kind, scanner, points, point_kind, *seen)


@njit(cache=True, nogil=True)
def _add_rays(
    places: NDArray, grid: tuple, place_kind: NDArray, scanner: NDArray, points: NDArray, point_kind: NDArray,
    free: NDArray, hit: NDArray, own: NDArray, other: NDArray, rays: NDArray,
) -> None:  # fmt: skip
    """Walk along each ray through the cells of a grid in plan, and count it at the places of each cell."""
    start, rows, n_x, n_y, edge, x0, y0 = grid
    last = np.full(len(places), -1, dtype=np.int64)
    for ray in range(len(points)):
        ox, oy = (scanner[ray, 0] - x0) / edge, (scanner[ray, 1] - y0) / edge
        px, py = (points[ray, 0] - x0) / edge, (points[ray, 1] - y0) / edge
        ix, iy, jx, jy = int(np.floor(ox)), int(np.floor(oy)), int(np.floor(px)), int(np.floor(py))
        dx, dy = px - ox, py - oy
        step_x, step_y = 1 if dx > 0 else -1, 1 if dy > 0 else -1
        next_x = ((ix + (step_x > 0)) - ox) / dx if dx != 0 else np.inf
        next_y = ((iy + (step_y > 0)) - oy) / dy if dy != 0 else np.inf
        for _ in range(abs(jx - ix) + abs(jy - iy) + 1):
            if 0 <= ix < n_x and 0 <= iy < n_y:
                cell = ix * n_y + iy
                for k in range(start[cell], start[cell + 1]):
                    place = rows[k]
                    if last[place] != ray:
                        last[place] = ray
                        _cross(places, place, place_kind, scanner, points, point_kind, ray, free, hit, own, other, rays)
            if next_x < next_y:
                ix += step_x
                next_x += step_x / dx
            else:
                iy += step_y
                next_y += step_y / dy if dy != 0 else np.inf


@njit(cache=True, nogil=True)
def _cross(
    places: NDArray, place: int, place_kind: NDArray, scanner: NDArray, points: NDArray, point_kind: NDArray, ray: int,
    free: NDArray, hit: NDArray, own: NDArray, other: NDArray, rays: NDArray,
) -> None:  # fmt: skip
    """Count the voxels of a place that a ray crosses, and the voxel of its point."""
    cx, cy, cz = places[place, 0] - HALF, places[place, 1] - HALF, places[place, 2] + LOW
    ox, oy, oz = scanner[ray, 0] - cx, scanner[ray, 1] - cy, scanner[ray, 2] - cz
    dx, dy, dz = points[ray, 0] - cx - ox, points[ray, 1] - cy - oy, points[ray, 2] - cz - oz
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    side, top = SIDE * CELL, SLICES * SLICE
    x, y, z = ox + dx, oy + dy, oz + dz
    if 0 <= x < side and 0 <= y < side and 0 <= z < top:
        k, i, j = int(z / SLICE), int(x / CELL), int(y / CELL)
        hit[place, k, i, j] = min(hit[place, k, i, j] + 1, _MOST)
        if point_kind[ray] == place_kind[place]:
            own[place, k, i, j] = min(own[place, k, i, j] + 1, _MOST)
        elif (
            point_kind[ray] < LOW_VEGETATION
            or point_kind[ray] == FURNITURE
            or (point_kind[ray] == LOW_VEGETATION and place_kind[place] == TREE)
        ):
            other[place, k, i, j] = min(other[place, k, i, j] + 1, _MOST)
    if length <= BEHIND:
        return
    # Part of the ray in the box of the voxels.
    near, far = 0.0, 1.0 - BEHIND / length
    for o, d, size in ((ox, dx, side), (oy, dy, side), (oz, dz, top)):
        if abs(d) < 1e-12:
            if not 0 <= o < size:
                return
        else:
            a, b = -o / d, (size - o) / d
            near, far = max(near, min(a, b)), min(far, max(a, b))
    if near >= far:
        return
    rays[place] += 1
    n = int((far - near) * length / (CELL / 2)) + 1
    before = -1
    for s in range(n):
        t = near + (s + 0.5) * (far - near) / n
        i, j, k = int((ox + t * dx) / CELL), int((oy + t * dy) / CELL), int((oz + t * dz) / SLICE)
        if 0 <= i < SIDE and 0 <= j < SIDE and 0 <= k < SLICES:
            voxel = (k * SIDE + i) * SIDE + j
            if voxel != before:
                free[place, k, i, j] = min(free[place, k, i, j] + 1, _MOST)
                before = voxel
