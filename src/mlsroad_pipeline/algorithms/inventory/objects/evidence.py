"""Evidence for objects: class probabilities of the space that an object fills and of its surroundings.

The unit is a cell of 0.2 m, aligned to world coordinates, so that the density of the points has no weight. Each point
counts one over the number of points in its cell. A scene sums over the points of its core alone; cores are disjoint, so
that the sums of the scenes of an object add up to those of the whole object.
"""

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.geometry.cells import bounding_box, sort_into_cells
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table

CELL = 0.2
"""Edge length of the cells, metres."""

REACH = 1.0
"""Largest distance between the cells of an object and of its surroundings, metres."""

ZONES = ("own", "beside", "above", "below")
"""The object itself, and its surroundings by the direction from the nearest cell of the object."""

SUMS = tuple(f"{zone}: {group}" for zone in ZONES for group in GROUPS)
"""Names of the sums: probability of a group in a zone, in cells."""

EVIDENCE_FIELDS = {
    "class": "str",
    "fragment": "int32",
    "i": "int64",
    "j": "int64",
    "k": "int64",
    **dict.fromkeys(SUMS, "float32"),
}
"""Columns of a table of evidence: class and fragment as in `fragments.FRAGMENT_FIELDS`, a cell of the object, and the
sums over the core points of this cell and of the surroundings that are nearest to it."""

GROUP_FEATURES = (
    "own_cells",
    *(f"own {group}" for group in GROUPS),
    *(name for zone in ZONES[1:] for name in (f"{zone}_cells", f"{zone}_ratio", *(f"{zone} {g}" for g in GROUPS))),
)
"""Names of the features of `group_features`."""

_MOST_BLOCKS = 1 << 24  # of the box around the objects of a class in a scene
_LEAST_CELLS = 2.0  # of a zone: the shares of smaller zones are lowered


@njit(cache=True, nogil=True)
def _sum_cells(
    order: NDArray[np.int32],
    starts: NDArray[np.int64],
    core: NDArray[np.bool_],
    owner: NDArray[np.integer],
    groups: NDArray[np.float32],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return numbers in the core and sums of groups per cell; points without an owner have no probabilities."""
    n_cells = len(starts) - 1
    n_core, sums = np.zeros(n_cells, np.int64), np.zeros((n_cells, groups.shape[1]), np.float32)
    for cell in range(n_cells):
        for point in order[starts[cell] : starts[cell + 1]]:
            n_core[cell] += core[point]
            own = owner[point]
            if own >= 0:
                for g in range(groups.shape[1]):
                    sums[cell, g] += groups[own, g]
    return n_core, sums


@njit(cache=True, nogil=True)
def _with_most_points(cell: NDArray[np.int64], n_points: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first row with most points of each cell; rows are ordered by cell."""
    best, n = np.empty(len(cell), np.int64), 0
    for i in range(len(cell)):
        if i == 0 or cell[i] != cell[i - 1]:
            best[n] = i
            n += 1
        elif n_points[i] > n_points[best[n - 1]]:
            best[n - 1] = i
    return best[:n].copy()


@njit(cache=True, nogil=True)
def _cells_around(
    centre: NDArray[np.float64], core_share: NDArray[np.float64], objects: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return cells with points of the core that may lie within reach of cells of objects, and are none themselves.

    They lie in the box of the objects, widened by the reach. Blocks are a little larger than the reach, so that cells
    within reach lie in adjacent ones.
    """
    edge = REACH + 1e-3
    box = bounding_box(centre[objects])
    low, least, most = np.empty(3), np.empty(3), np.empty(3)
    for axis in range(3):
        low[axis] = box[0, axis] - 1.5 * edge  # objects lie in blocks 1 and above
        least[axis], most[axis] = box[0, axis] - REACH, box[1, axis] + REACH
    nx, ny = int((box[1, 0] - low[0]) / edge) + 2, int((box[1, 1] - low[1]) / edge) + 2
    nz = int((box[1, 2] - low[2]) / edge) + 2
    filtered = float(nx) * float(ny) * float(nz) <= _MOST_BLOCKS
    near = np.zeros((nx, ny, nz) if filtered else (0, 0, 0), np.bool_)
    free = np.empty(len(core_share), np.bool_)
    for cell in range(len(core_share)):
        free[cell] = core_share[cell] > 0.0
    for own in objects:
        free[own] = False
        if filtered:
            i, j = int((centre[own, 0] - low[0]) / edge), int((centre[own, 1] - low[1]) / edge)
            k = int((centre[own, 2] - low[2]) / edge)
            for a in range(27):
                near[i + a // 9 - 1, j + a // 3 % 3 - 1, k + a % 3 - 1] = True
    found, n = np.empty(len(centre), np.int64), 0
    for cell in range(len(centre)):
        x, y, z = centre[cell, 0], centre[cell, 1], centre[cell, 2]
        inside = (x >= least[0]) & (x <= most[0]) & (y >= least[1]) & (y <= most[1]) & (z >= least[2]) & (z <= most[2])
        if free[cell] and inside:
            i, j, k = int((x - low[0]) / edge), int((y - low[1]) / edge), int((z - low[2]) / edge)
            found[n] = cell
            n += 1 if not filtered or near[i, j, k] else 0
    return found[:n].copy()


class SceneCells:
    """Cells of a scene with their mean class probabilities."""

    def __init__(
        self,
        local: NDArray[np.floating],
        *,
        core: NDArray[np.bool_],
        origin: NDArray[np.float64],
        evidence: ClassEvidence,
    ) -> None:
        cells = sort_into_cells(local, origin=origin, size=CELL)
        if not cells.packed:
            apart = np.ptp(cells.index, axis=0).max() * CELL
            raise DataError(f"the points of a scene lie up to {apart:,.0f} m apart: remove stray points")
        self.of_point = cells.owner()
        n_core, sums = _sum_cells(cells.order, cells.starts, core, evidence.owner, evidence.of_groups)
        self.key = cells.index
        self.centre = (self.key + 0.5) * CELL - origin
        self.count = np.diff(cells.starts)
        self.core = core
        self.core_share = n_core / self.count
        self.groups = sums / self.count[:, None]

    def around(self, points: NDArray[np.int64], fragment: NDArray[np.integer]) -> pd.DataFrame:
        """Sum the evidence for the objects of one class."""
        if not len(points):
            return empty_table({name: kind for name, kind in EVIDENCE_FIELDS.items() if name != "class"})
        n_fragments = int(fragment.max()) + 1
        key = self.of_point[points] * n_fragments + fragment
        ordered, order = radix_argsort(key, int(key.max()).bit_length())
        starts = np.flatnonzero(np.diff(ordered, prepend=-1))
        pairs, n_points = ordered[starts], np.diff(np.append(starts, len(key)))
        cell, owner = pairs // n_fragments, pairs % n_fragments
        n_core = np.add.reduceat(self.core[points][order].astype(np.float64), starts)
        sums = np.zeros((len(ZONES), len(pairs), len(GROUPS)))
        sums[0] = self.groups[cell] * (n_core / self.count[cell])[:, None]
        # A cell with points of several objects stands for the one with most of them.
        best = _with_most_points(cell, n_points)
        rest = _cells_around(self.centre, self.core_share, cell)
        distance, near = cKDTree(self.centre[cell[best]]).query(self.centre[rest], distance_upper_bound=REACH + 1e-6)
        rest, near = rest[np.isfinite(distance)], best[near[np.isfinite(distance)]]
        step = self.centre[rest] - self.centre[cell[near]]
        level = np.hypot(step[:, 0], step[:, 1]) + 1e-6
        zone = 1 + (step[:, 2] > level) + 2 * (step[:, 2] < -level)
        target = csr_array((self.core_share[rest], (zone * len(pairs) + near, np.arange(len(rest)))), shape=(
            len(ZONES) * len(pairs), len(rest)
        ))  # fmt: skip
        sums += np.asarray(target @ self.groups[rest]).reshape(sums.shape)
        table = {"fragment": owner.astype(np.int32), **dict(zip("ijk", self.key[cell].T, strict=True))}
        flat = sums.transpose(1, 0, 2).reshape(len(pairs), -1).astype(np.float32)
        return pd.DataFrame(table | dict(zip(SUMS, flat.T, strict=True)))


def group_features(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the features of sums of evidence."""
    zones = np.round(sums, 6).reshape(-1, len(ZONES), len(GROUPS))
    size = zones.sum(axis=2)
    own = np.maximum(size[:, :1], 1e-6)
    parts = [np.log1p(size[:, :1]), zones[:, 0] / own]
    for k in range(1, len(ZONES)):
        cells = size[:, k : k + 1]
        parts += [np.log1p(cells), cells / own, zones[:, k] / np.maximum(cells, _LEAST_CELLS)]
    return np.concatenate(parts, axis=1)
