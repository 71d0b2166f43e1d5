"""Overhead wires: parabolas in upright planes through the points of wires."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

LEAST_LENGTH = 3.0
"""Shorter wires are left out, metres."""

_NEAR = 0.8  # radius of the neighbourhood that gives a direction, metres
_NEIGHBOURS, _FEWEST = (4, 12), 3  # largest numbers of points in it, and the least one
_CHUNK = 100_000  # points whose neighbourhoods are in memory
_STRAIGHT, _FLAT = 0.7, 0.7  # least straightness of a neighbourhood, and least share of its direction in plan
_REACH = 200.0  # from the first point of a wire to its ends, metres
_LOCAL, _TUBE = 3.0, 0.4  # length and radius of the surroundings that a first look takes, metres
_LEAST_LOCAL, _LEAST_SHARE = 5, 0.3  # points near the line there, and their share in the tube around it
_LEAST_POINTS = 8
_LATERAL, _VERTICAL = 0.12, 0.1  # largest distances of the points of a wire from its curve, metres
_GAP = 6.0  # largest gap within a wire, metres
_TRIES, _LEAST_APART = 40, 0.3  # parabolas through three points per window, and least distance of these, metres
_WINDOWS = (10.0, 30.0, 90.0, np.inf)  # largest distances of the points of a parabola from its first one, metres
_MOST_SAG = 0.02  # largest curvature of a parabola, 1/m: a span of 40 m with a sag of 4 m
_MOST_BEND, _LEAST_BENT = 0.002, 10.0  # curvature in plan, 1/m (wind, errors of the path), from this length on, metres
_ROUNDS = 5


@dataclass(frozen=True)
class Frame:
    """Plan of a wire: a line, and a parabola across it."""

    start: NDArray[np.float64]  # A place on the line, metres; ways along the line begin there
    along: NDArray[np.float64]  # Unit vector of the line
    # Square, linear and constant coefficient of the distance to the left of the line, by the way along it
    bend: NDArray[np.float64]

    def way(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the way of places along the line."""
        way: NDArray[np.float64] = (xy - self.start) @ self.along
        return way

    def apart(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance of places from the curve, across the line."""
        across = (xy - self.start) @ [-self.along[1], self.along[0]]
        return np.abs(across - np.polyval(self.bend, self.way(xy)))

    def fitted(self, xy: NDArray[np.float64]) -> Frame:
        """Return the line of least squares through places, in the sense of this one, and their bend across it."""
        middle = xy.mean(axis=0)
        along = np.linalg.svd(xy - middle, full_matrices=False)[2][0]
        along = along if along @ self.along > 0 else -along
        way, across = (xy - middle) @ along, (xy - middle) @ [-along[1], along[0]]
        bend = np.polyfit(way, across, 2) if np.ptp(way) > _LEAST_BENT else np.zeros(3)
        return Frame(middle, along, bend if abs(bend[0]) < _MOST_BEND else np.zeros(3))


@dataclass(frozen=True)
class Wire:
    """Curve of a wire."""

    frame: Frame  # Its plan
    # Square, linear and constant coefficient of its height, by the way along the line of the plan
    curve: NDArray[np.float64]
    ends: tuple[float, float]  # Ways of its first and its last point, metres
    clearance: float  # Least height of its points above the ground, metres; NaN where it is not known
    score: float  # Mean probability of its points

    def at(self, way: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places on the curve."""
        along, across = self.frame.along, np.polyval(self.frame.bend, way)
        xy = self.frame.start + way[:, None] * along + across[:, None] * np.array([-along[1], along[0]])
        return np.column_stack([xy, np.polyval(self.curve, way)])


class Wires:
    """Points of wires that are not yet part of one."""

    def __init__(self, points: NDArray[np.float64]) -> None:
        self.points = points
        self.free = np.ones(len(points), dtype=bool)
        self.tree = cKDTree(points[:, :3])
        self.random = np.random.default_rng(len(points))

    def found(self) -> list[Wire]:
        """Return the wires, from the one with the straightest neighbourhood on."""
        wires = []
        along, straightness = self._directions()
        for seed in np.argsort(-straightness, kind="stable"):
            if not self.free[seed] or straightness[seed] < _STRAIGHT:
                continue
            wire = self._grown(int(seed), along[seed])
            if wire is not None:
                wires.append(wire)
        return wires

    def _directions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return direction in plan and straightness (0 to 1) of the neighbourhood of each point, 0 without one.

        Of a smaller and a larger neighbourhood the straighter one counts: the larger one of a wire may hold its
        neighbour, the smaller one only noise.
        """
        along, straight = np.zeros((len(self.points), 2)), np.zeros(len(self.points))
        for first in range(0, len(self.points), _CHUNK):
            part = slice(first, first + _CHUNK)
            apart, near = self.tree.query(self.points[part, :3], k=max(_NEIGHBOURS) + 1, distance_upper_bound=_NEAR)
            for number in _NEIGHBOURS:
                found, value = self._direction(part, near[:, : number + 1], np.isfinite(apart[:, : number + 1]))
                better = value > straight[part]
                along[part][better], straight[part][better] = found[better], value[better]
        return along, straight

    def _direction(
        self, part: slice, near: NDArray[np.int64], there: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        count = there.sum(axis=1)
        places = self.points[np.where(there, near, 0), :3] - self.points[part, None, :3]
        places[~there] = 0.0
        places -= (places.sum(axis=1) / count[:, None])[:, None]
        places[~there] = 0.0
        values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", places, places))
        straight = 1.0 - values[:, 1] / np.maximum(values[:, 2], 1e-12)
        along = axes[:, :2, 2]
        flat = np.hypot(*along.T)
        straight = np.where((count > _FEWEST) & (flat > _FLAT), straight, 0.0)
        return along / np.maximum(flat, 1e-12)[:, None], straight

    def _grown(self, seed: int, along: NDArray[np.float64]) -> Wire | None:
        """Return the wire through a point; its points are taken. Without a wire, the point alone is."""
        self.free[seed] = False
        if not self._is_line(seed, along):
            return None
        around = np.array(self.tree.query_ball_point(self.points[seed, :3], _REACH, return_sorted=True), dtype=np.int64)
        around = np.append(around[self.free[around]], seed)
        frame = Frame(self.points[seed, :2], along, np.zeros(3))
        for _ in range(_ROUNDS):
            rows, curve = self._consensus(around, seed, frame)
            if len(rows) < _LEAST_POINTS or np.ptp(frame.way(self.points[rows, :2])) < _NEAR:
                return None
            frame = frame.fitted(self.points[rows, :2])
        rows, curve = self._consensus(around, seed, frame)
        if len(rows) < _LEAST_POINTS:
            return None
        way = frame.way(self.points[rows, :2])
        if np.ptp(way) < LEAST_LENGTH:
            return None
        self.free[rows] = False
        self._take_beside(around, frame, curve, way)
        heights = self.points[rows, 3]
        lowest = float(np.nanmin(heights)) if np.isfinite(heights).any() else np.nan
        return Wire(frame, curve, (float(way.min()), float(way.max())), lowest, float(self.points[rows, 4].mean()))

    def _is_line(self, seed: int, along: NDArray[np.float64]) -> bool:
        """Return whether the points nearby lie on a line through a point rather than all around it, as foliage does."""
        rows = np.array(self.tree.query_ball_point(self.points[seed, :3], _LOCAL), dtype=np.int64)
        apart = self.points[rows[self.free[rows]], :3] - self.points[seed, :3]
        way, across = apart[:, :2] @ along, np.abs(apart[:, :2] @ [-along[1], along[0]])
        inside = across < _LATERAL
        if inside.sum() < _LEAST_LOCAL or np.ptp(way[inside]) < _LOCAL / 2:
            return False
        slope = np.polyfit(way[inside], apart[inside, 2], 1)[0]
        off = np.hypot(across, apart[:, 2] - slope * way)
        return bool((off < _LATERAL).sum() >= max(_LEAST_LOCAL, _LEAST_SHARE * (off < _TUBE).sum()))

    def _take_beside(
        self, rows: NDArray[np.int64], frame: Frame, curve: NDArray[np.float64], span: NDArray[np.float64]
    ) -> None:
        """Take the points up to twice as far from a wire: noise, of which no second wire is to be made."""
        way = frame.way(self.points[rows, :2])
        near = (frame.apart(self.points[rows, :2]) < 2 * _LATERAL) & (way > span.min()) & (way < span.max())
        near &= np.abs(self.points[rows, 2] - np.polyval(curve, way)) < 2 * _VERTICAL
        self.free[rows[near]] = False

    def _consensus(
        self, rows: NDArray[np.int64], seed: int, frame: Frame
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the points of the parabola through the seed with most points, connected to it, and the parabola."""
        near = (frame.apart(self.points[rows, :2]) < _LATERAL) | (rows == seed)
        rows, way = _connected(rows[near], frame.way(self.points[rows[near], :2]), seed)
        z, curve = self.points[rows, 2], np.zeros(3)
        if len(rows) < _LEAST_POINTS:
            return rows[:0], curve
        own = int(np.flatnonzero(rows == seed)[0])
        best = self._best_parabola(way - way[own], z - z[own])
        if best.sum() < _LEAST_POINTS:
            return rows[:0], curve
        curve = np.polyfit(way[best], z[best], 2)
        inside = np.abs(z - np.polyval(curve, way)) < _VERTICAL
        inside[own] = True
        kept, _ = _connected(rows[inside], way[inside], seed)
        return kept, curve

    def _best_parabola(self, way: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return the points near the parabola through the origin and two random points that has most of them."""
        pairs = [
            inside[self.random.integers(len(inside), size=(2, _TRIES))]
            for inside in (np.flatnonzero(np.abs(way) <= window) for window in _WINDOWS)
        ]
        first, second = np.concatenate(pairs, axis=1)
        a, b = way[first], way[second]
        apart = np.minimum(np.minimum(np.abs(a), np.abs(b)), np.abs(a - b)) >= _LEAST_APART
        a, b, za, zb = a[apart], b[apart], z[first[apart]], z[second[apart]]
        square = (za / a - zb / b) / (a - b)
        linear = za / a - square * a
        likely = (square > -1e-3) & (square < _MOST_SAG)
        near = (
            np.abs(z - np.multiply.outer(square[likely], way**2) - np.multiply.outer(linear[likely], way)) < _VERTICAL
        )
        return near[near.sum(axis=1).argmax()] if len(near) else np.zeros(len(way), dtype=bool)


def _connected(
    rows: NDArray[np.int64], way: NDArray[np.float64], seed: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the points along a line that are connected to the seed by gaps of at most `_GAP`, and their ways."""
    order = np.argsort(way, kind="stable")
    rows, way = rows[order], way[order]
    part = np.cumsum(np.append(False, np.diff(way) > _GAP))
    same = part == part[np.flatnonzero(rows == seed)[0]]
    return rows[same], way[same]


LIKELY = 0.15
"""Least probability of a point of a wire."""

LEAST_SCORE = 0.5
"""Wires whose points have a lower mean probability are left out."""

CELL = 0.1
"""Points of wires are thinned to one per cube of this edge, metres."""

WIRE_COLUMNS = ("x", "y", "z", "height", "probability")
"""Columns of the thinned points of wires: world coordinates, height above the ground (metres), probability."""

_SPACING = 1.0  # of the vertices, metres


def wire_probability(evidence: ClassEvidence) -> NDArray[np.float32]:
    """Return the probability of each point of a scene to be a wire, shape (n,); 0 for points without a class."""
    return np.append(evidence.of_groups[:, GROUPS.index("wire")], np.float32(0.0))[evidence.owner]


def no_wire_points() -> pd.DataFrame:
    """Return a table of points of wires without rows."""
    return empty_table(dict.fromkeys(WIRE_COLUMNS, "float64"))


def wire_points(
    xyz: NDArray[np.floating],
    height: NDArray[np.floating],
    probability: NDArray[np.floating],
    *,
    core: NDArray[np.bool_],
    origin: NDArray[np.float64],
) -> pd.DataFrame:
    """Return the points of wires in the core of a scene, thinned to one per cube of `CELL`."""
    rows = np.flatnonzero((probability >= LIKELY) & core)
    if len(rows) == 0:
        return no_wire_points()
    places = xyz[rows].astype(np.float64) + origin
    _, cell = np.unique(np.floor(places / CELL).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    means = np.column_stack([np.bincount(cell, places[:, k]) / count for k in range(3)])
    lowest = np.full(len(count), np.inf)
    np.fmin.at(lowest, cell, height[rows].astype(np.float64))
    lowest[np.isinf(lowest)] = np.nan
    likely = np.bincount(cell, probability[rows]) / count
    return pd.DataFrame(np.column_stack([means, lowest, likely]), columns=list(WIRE_COLUMNS))


def join_wires(
    scenes: Sequence[pd.DataFrame], trajectory: Trajectory | None = None, *, least_score: float = LEAST_SCORE
) -> pd.DataFrame:
    """Return the wires of a pass as lines.

    A wire is a parabola in an upright plane, which differs from a catenary by millimetres where the sag is a tenth of
    the span or less.
    """
    filled = [table for table in scenes if len(table)]
    if not filled:
        return line_table([])
    points = np.concatenate([table[list(WIRE_COLUMNS)].to_numpy(dtype=np.float64) for table in filled])
    origin = np.append(np.floor(points[0, :3]), [0.0, 0.0])
    wires = [wire for wire in Wires(points - origin).found() if wire.score >= least_score]
    return line_table([_row(wire, origin, trajectory) for wire in wires])


def _row(wire: Wire, origin: NDArray[np.float64], trajectory: Trajectory | None) -> dict[str, object]:
    low, high = wire.ends
    way = np.linspace(low, high, max(3, int(np.ceil((high - low) / _SPACING)) + 1))
    vertices = wire.at(way)
    chord = np.interp(way, [low, high], vertices[[0, -1], 2])
    vertices += origin[:3]
    measures = {"sag": float(max((chord - vertices[:, 2] + origin[2]).max(), 0.0)), "clearance": wire.clearance}
    measures["score"] = wire.score
    return line_row("wire", vertices, trajectory, **measures)
