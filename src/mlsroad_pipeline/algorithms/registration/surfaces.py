"""Flat patches and poles of a point cloud, the surfaces by which two recordings are compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.cells import sort_into_cells

CELL = 0.5
"""Edge length of the cells that patches are fitted in, metres."""

FEWEST = 8
"""Fewest points of a patch or of a piece of a pole."""

THICKNESS = 0.03
"""Largest standard deviation of a patch across its plane, metres."""

WIDTH = 0.08
"""Least standard deviation of a patch along its plane, and largest one of a pole across its axis, metres."""

RADIUS = 0.3
"""Largest radius of a pole, metres."""

ROUND = 0.025
"""Largest standard deviation of the distances of a pole's points from its circle, metres."""


ALONE = 0.8
"""Least share of a pole's points among those of its cell and the eight around it; a strip of a wall has less."""


@dataclass(frozen=True)
class Surfaces:
    """Patches (mean, unit normal of either sign), and the axis of each pole in each layer of `CELL` metres."""

    centre: NDArray[np.float64]
    normal: NDArray[np.float64]
    pole: NDArray[np.float64]

    @property
    def level(self) -> NDArray[np.bool_]:
        """Patches that lie flat, such as the ground."""
        return np.abs(self.normal[:, 2]) > 0.9

    @property
    def upright(self) -> NDArray[np.bool_]:
        """Patches that stand, such as facades."""
        return np.abs(self.normal[:, 2]) < 0.3

    def moved(
        self, shift: NDArray[np.float64], heading: float = 0.0, pivot: NDArray[np.float64] | None = None
    ) -> Surfaces:
        """Return the surfaces after a turn about the vertical through `pivot`, then a shift."""
        turn = turn_of(heading)
        middle = np.zeros(3) if pivot is None else pivot
        return replace(
            self,
            centre=(self.centre - middle) @ turn.T + middle + shift,
            normal=self.normal @ turn.T,
            pole=(self.pole - middle) @ turn.T + middle + shift,
        )

    def thinned(self, most: int) -> Surfaces:
        """Return at most so many level patches, upright patches and pieces of poles, evenly spaced in their order."""
        kinds = (np.flatnonzero(self.level), np.flatnonzero(self.upright), np.arange(len(self.pole)))
        level, upright, pole = (rows[:: max(1, -(-len(rows) // most))] for rows in kinds)
        patch = np.concatenate([level, upright])
        return Surfaces(self.centre[patch], self.normal[patch], self.pole[pole])


def turn_of(heading: float) -> NDArray[np.float64]:
    """Return the matrix of a turn about the vertical, radians anticlockwise."""
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def find_surfaces(xyz: NDArray[np.floating]) -> Surfaces:
    """Return the patches and poles of a cloud, whose coordinates are relative to an origin near the points.

    Patches are cells of 0.5 m whose points lie within 0.03 m of a plane. Plants and edges have none.
    """
    cells = sort_into_cells(xyz, origin=np.zeros(3), size=CELL)
    counts = np.diff(cells.starts)
    kept = counts >= FEWEST
    if not kept.any():
        return Surfaces(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)))
    first = cells.starts[:-1][kept]
    base = (cells.index[kept] + 0.5) * CELL
    rows = cells.order[np.repeat(kept, counts)]
    local = np.asarray(xyz[rows], dtype=np.float64) - np.repeat(base, counts[kept], axis=0)
    starts = np.concatenate([[0], np.cumsum(counts[kept])[:-1]]) if len(first) else first
    mean = np.add.reduceat(local, starts) / counts[kept][:, None]
    spread = _covariances(local, mean, starts, counts[kept])
    values, vectors = np.linalg.eigh(spread)
    widths = np.sqrt(np.maximum(values, 0.0))
    flat = (widths[:, 0] < THICKNESS) & (widths[:, 1] > WIDTH)
    axis = np.abs(vectors[:, 2, 2]) > 0.95
    linear = axis & (widths[:, 2] > 0.1) & (widths[:, 1] < 1.5 * WIDTH) & ~flat
    points = np.repeat(linear, counts[kept])
    owner = np.repeat(np.flatnonzero(linear), counts[kept][linear])
    pole, n_points = _poles(xyz[rows[points]].astype(np.float64), owner, (base + mean), cells.index[kept][:, 2])
    alone = n_points >= ALONE * _points_around(pole, cells.index, counts)
    return Surfaces((base + mean)[flat], vectors[flat, :, 0], pole[alone])


def _covariances(
    local: NDArray[np.float64], mean: NDArray[np.float64], starts: NDArray[np.int64], counts: NDArray[np.int64]
) -> NDArray[np.float64]:
    spread = np.empty((len(mean), 3, 3))
    for a in range(3):
        for b in range(a, 3):
            products = np.add.reduceat(local[:, a] * local[:, b], starts) / counts - mean[:, a] * mean[:, b]
            spread[:, a, b] = spread[:, b, a] = products
    return spread


def _poles(
    xyz: NDArray[np.float64], cell: NDArray[np.int64], centre: NDArray[np.float64], layer: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the axes of poles and their numbers of points; neighbouring narrow cells of a layer share a pole."""
    if not len(xyz):
        return np.empty((0, 3)), np.empty(0)
    used, cell = np.unique(cell, return_inverse=True)
    places = np.column_stack([centre[used, :2], layer[used] * 10.0])
    pairs = cKDTree(places).query_pairs(2 * WIDTH + RADIUS, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(used), len(used)))
    n, part = connected_components(links, directed=False)
    owner = part[cell]
    middle = (
        np.column_stack([np.bincount(owner, xyz[:, a], n) for a in range(3)]) / np.bincount(owner, minlength=n)[:, None]
    )
    x, y = (xyz - middle[owner])[:, :2].T
    rho = x * x + y * y
    sums = [np.bincount(owner, v, n) for v in (x * x, x * y, y * y, x * rho, y * rho, rho, np.ones_like(x))]
    xx, xy, yy, xr, yr, r, count = sums
    # Circle of least squares (Kasa): rho = 2 a x + 2 b y + c, with x and y relative to their means
    det = np.where(xx * yy - xy * xy > 1e-12, xx * yy - xy * xy, np.inf)
    a, b = (xr * yy - yr * xy) / (2 * det), (yr * xx - xr * xy) / (2 * det)
    radius = np.sqrt(a * a + b * b + r / count)
    off = np.hypot(x - a[owner], y - b[owner]) - radius[owner]
    error = np.sqrt(np.bincount(owner, off * off, n) / count)
    good = (count >= FEWEST) & (radius < RADIUS) & (error < ROUND) & (np.hypot(a, b) <= radius)
    middle[:, 0] += a
    middle[:, 1] += b
    return middle[good], count[good]


def _points_around(
    place: NDArray[np.float64], index: NDArray[np.int64], counts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the number of points in the cell of each place and in the eight around it in plan."""
    low = index.min(axis=0) - 2
    size = index.max(axis=0) - low + 3
    keys = np.ravel_multi_index(tuple((index - low).T), tuple(size))  # ascending, as the cells are
    own = np.floor(place / CELL).astype(np.int64) - low
    total = np.zeros(len(place), dtype=np.int64)
    for dx, dy in np.ndindex(3, 3):
        wanted = np.ravel_multi_index(tuple(np.add(own, (dx - 1, dy - 1, 0)).T), tuple(size), mode="clip")
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        total += np.where(keys[at] == wanted, counts[at], 0)
    return total
