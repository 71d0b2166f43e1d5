"""Doubtful labels: clusters whose class is unlikely where they stand, and groups of points that are worth a look.

Each rule was kept for its share of wrong clusters in labelled recordings, see `docs/results.md`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells

VEHICLE_SIZED, ON_FACADE, IN_VEGETATION, IN_THE_AIR = (
    "low vegetation of the size of a vehicle",
    "vegetation on a facade",
    "a sign, furniture or a wall inside vegetation",
    "a vehicle or a person above the ground",
)
DOUBTS = (VEHICLE_SIZED, ON_FACADE, IN_VEGETATION, IN_THE_AIR)
"""Reasons for which a cluster is doubtful."""

CELL = 0.4
"""Edge of the cells that clusters are found in, metres."""

LEAST_POINTS, FARTHEST = 100, 40.0
"""Fewest points, and largest distance from the path in metres, at which a person can judge a cluster."""

_THINNED = 8.0  # points of a dense cluster per point of the sample that clusters are found in, at least

_TYPES = {"reason": "str", "class": "str", "points": "int64", **dict.fromkeys("xyz", "float64")}

_LOW, _VEGETATION, _BUILDING = ("low vegetation",), ("low vegetation", "tree", "vegetation"), ("building",)
_MOVING = ("vehicle", "two-wheeler", "person")
_SOLID = ("sign", "wall or fence", "street furniture")
_GROUND = ("paved ground", "natural ground", "ground")
_LONG, _WIDE, _TOP, _BOTTOM = (1.2, 6.0), (0.8, 2.8), (0.8, 2.6), 0.6  # of a vehicle, metres
_BESIDE, _ON_WALL, _INSIDE, _ABOVE = 0.2, 0.6, 0.5, 0.8  # shares of the neighbouring cells; height, metres

_ODDS = dict.fromkeys(("low vegetation", "pole", *_SOLID, *_MOVING), 3.0)
_STEEP, _STEEP_ODDS, _RULE_ODDS = 0.4, 2.0, 10.0
"""Factors of the odds that a group is wrong: of its class, of natural ground higher than `_STEEP`, of a rule."""


class Cells(NamedTuple):
    """Points of a scene, or a sample with one point per class and cell."""

    xyz: NDArray[np.floating]  # Coordinates, metres
    height: NDArray[np.floating]  # Heights above the ground, metres
    label: NDArray[np.integer]  # Number of the class in `names`; -1 without one
    names: Sequence[str]  # Names of the classes


def _numbers(names: Sequence[str], wanted: Sequence[str]) -> list[int]:
    return [number for number, name in enumerate(names) if name in wanted]


class _Grid:
    """Cells of points: one per class that a cube of space has points of, ordered by cube and class."""

    def __init__(self, cells: Cells, size: float) -> None:
        self._corner, self._size = cells.xyz.min(axis=0), size
        extent = np.floor((cells.xyz.max(axis=0) - self._corner) / size).astype(np.int64)
        self._ny, self._nz = (int(n) + 3 for n in extent[1:])
        self._n_labels = len(cells.names) + 1
        apart = np.zeros((len(cells.label), 3))  # a share of the points of each class has nearly all of its cells
        apart[:, 0] = (cells.label + 1) * (np.ptp(cells.xyz[:, 0]) + 2 * size)
        thin = first_in_cells(cells.xyz - self._corner + apart, size / 2)
        keys = self.keys(cells.xyz[thin], cells.label[thin])
        self.kept, first, self.points = np.unique(keys, return_index=True, return_counts=True)
        self.first = thin[first]
        self.label, self.cube = cells.label[self.first], self.kept // self._n_labels
        around = (-1, 0, 1)
        self.offsets = [(i * self._ny + j) * self._nz + k for i in around for j in around for k in around]

    def keys(self, xyz: NDArray[np.floating], label: NDArray[np.integer]) -> NDArray[np.int64]:
        """Return the number of the cell of each point."""
        index = np.floor((xyz - self._corner) / self._size).astype(np.int64) + 1
        return ((index[:, 0] * self._ny + index[:, 1]) * self._nz + index[:, 2]) * self._n_labels + label

    def occupied(self, labels: Sequence[int]) -> NDArray[np.int64]:
        """Return the cubes with points of classes, in order."""
        cubes = self.cube[np.isin(self.label, labels)]
        return cubes[np.diff(cubes, prepend=-1) > 0]

    def components(self, occupied: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the connected component of each cube; cubes touch at faces, edges and corners."""
        pairs = [np.stack(_found(occupied, occupied + offset)) for offset in self.offsets if offset > 0]
        first, second = np.concatenate(pairs, axis=1)
        edges = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(len(occupied),) * 2)
        return connected_components(edges, directed=False)[1].astype(np.int64)

    def beside(self, own: NDArray[np.int64], component: NDArray[np.int64], n: int, others: NDArray) -> NDArray:
        """Return the number of pairs of a cube of each component and a neighbouring cube of others."""
        counts = np.zeros(n)
        for offset in self.offsets:
            start, _ = _found(others, own + offset)
            counts += np.bincount(component[start], minlength=n)
        return counts


def _found(occupied: NDArray[np.int64], wanted: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows of wanted cells that are occupied, and their places in the sorted occupied ones."""
    if not len(occupied):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    place = np.minimum(np.searchsorted(occupied, wanted), len(occupied) - 1)
    rows = np.flatnonzero(occupied[place] == wanted)
    return rows, place[rows]


def doubtful_clusters(cells: Cells, *, size: float = CELL, least: int = LEAST_POINTS) -> tuple[pd.DataFrame, NDArray]:
    """Return the clusters whose class is unlikely where they stand, and the cluster of each point (-1: none).

    The table has the reason (one of `DOUBTS`), the class, the number of points, and the mean place in the coordinates
    of the cells. A cluster is the connected cells of one class; `least` is its fewest points.
    """
    owner, tables = np.full(len(cells.label), -1, np.int64), [pd.DataFrame(columns=["reason", "class", *"xyz"])]
    if not len(cells.label):
        return tables[0].assign(points=0).astype(_TYPES), owner
    grid = _Grid(cells, size)
    flagged: dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
    for label in _numbers(cells.names, (*_VEGETATION, *_SOLID, *_MOVING)):
        rows = np.flatnonzero(grid.label == label)
        if len(rows):
            found, own = _of_class(cells, label, grid, least / _THINNED)
            flagged[label] = grid.kept[rows[own >= 0]], own[own >= 0] + sum(map(len, tables))
            tables += [found] if len(found) else []
    for label, (keys, number) in flagged.items():
        points = np.flatnonzero(cells.label == label) if len(keys) else np.zeros(0, np.int64)
        start, place = _found(keys, grid.keys(cells.xyz[points], cells.label[points]))
        owner[points[start]] = number[place]
    table = pd.concat(tables[1:] or tables, ignore_index=True)
    counts = np.bincount(owner[owner >= 0], minlength=len(table))
    large = counts >= least
    number = np.append(np.where(large, np.cumsum(large) - 1, -1), -1)
    return table.assign(points=counts)[large].reset_index(drop=True).astype(_TYPES), number[owner]


def _of_class(cells: Cells, label: int, grid: _Grid, least: float) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Return the doubtful clusters of a class, and the cluster of each of its cells."""
    name, rows = cells.names[label], np.flatnonzero(grid.label == label)
    own, weight, first = grid.cube[rows], grid.points[rows], grid.first[rows]
    component = grid.components(own)
    n = int(component.max()) + 1
    points = np.bincount(component, weights=weight, minlength=n).astype(np.int64)
    every = [number for number in range(len(cells.names)) if number != label]
    groups = [_numbers(cells.names, wanted) for wanted in (_VEGETATION, _BUILDING, _GROUND)]
    vegetation, building, ground, others = (
        grid.beside(own, component, n, grid.occupied([k for k in group if k != label])) for group in (*groups, every)
    )
    standing = np.maximum(others - ground, 1.0)
    shares = vegetation / standing, building / standing
    reason = np.full(n, -1)
    order = np.argsort(component, kind="stable")
    starts = np.searchsorted(component[order], np.arange(n + 1))
    for k in np.flatnonzero(points >= least).tolist():
        at = first[order[starts[k] : starts[k + 1]]]
        reason[k] = _reason(name, cells.xyz[at], cells.height[at], (float(shares[0][k]), float(shares[1][k])))
    chosen = np.flatnonzero(reason >= 0)
    number = np.full(n, -1)
    number[chosen] = np.arange(len(chosen))
    table: dict[str, Any] = {"reason": [DOUBTS[k] for k in reason[chosen]], "class": name}
    for k, axis in enumerate("xyz"):
        table[axis] = (np.bincount(component, weights=weight * cells.xyz[first, k], minlength=n) / points)[chosen]
    return pd.DataFrame(table), number[component]


def _reason(name: str, xyz: NDArray[np.floating], height: NDArray[np.floating], shares: tuple[float, float]) -> int:
    """Return the number of the reason to doubt a cluster, -1 for none; the shares are of its neighbouring cells."""
    vegetation, building = shares
    bottom, top = np.quantile(height, (0.02, 0.98))
    if name in _VEGETATION and building > _ON_WALL:
        return DOUBTS.index(ON_FACADE)
    if name in _SOLID and vegetation > _INSIDE:
        return DOUBTS.index(IN_VEGETATION)
    if name in _MOVING and bottom > _ABOVE:
        return DOUBTS.index(IN_THE_AIR)
    if name in _LOW and vegetation < _BESIDE and bottom < _BOTTOM and _TOP[0] < top < _TOP[1]:
        _, axes = np.linalg.eigh(np.cov(xyz[:, :2].T))
        short, long = sorted(np.ptp(xyz[:, :2] @ axes, axis=0))
        if _LONG[0] < long < _LONG[1] and _WIDE[0] < short < _WIDE[1]:
            return DOUBTS.index(VEHICLE_SIZED)
    return -1


def worth_of_look(
    names: ArrayLike,
    confidence: ArrayLike,
    extent: ArrayLike,
    points: ArrayLike,
    distance: ArrayLike,
    *,
    unlikely: ArrayLike = False,
) -> NDArray[np.float64]:
    """Return how much the look at each group of points is worth.

    It is the probability that the class is wrong (from confidence, class, vertical extent and whether the class is
    unlikely there), times the logarithm of the number of points, times whether a person can judge the group: at least
    `LEAST_POINTS` points within `FARTHEST` metres of the path (NaN: unknown).
    """
    sure, size, away = (np.asarray(each, np.float64) for each in (confidence, points, distance))
    odds = (1.005 - sure) / np.maximum(sure, 1e-3) * np.array([_ODDS.get(str(name), 1.0) for name in np.asarray(names)])
    steep = (np.asarray(names) == "natural ground") & (np.asarray(extent) > _STEEP)
    odds = odds * np.where(steep, _STEEP_ODDS, 1.0) * np.where(np.asarray(unlikely), _RULE_ODDS, 1.0)
    can_judge = np.minimum(size / LEAST_POINTS, 1.0) ** 2 * np.where(away > FARTHEST, 0.01, 1.0)
    return can_judge * np.log10(10.0 + size) * odds / (1.0 + odds)
