"""Overhead wires: parabolas in upright planes through the points of wires."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.class_groups import GROUPS, ClassEvidence
from mlsroad_pipeline.algorithms.inventory.lines import line_row, line_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

LIKELY = 0.15
"""Least probability of a point of a wire."""

LEAST_SCORE = 0.5
"""Wires whose points have a lower mean probability are left out."""

CELL = 0.1
"""Points of wires are thinned to one per cube of this edge, metres."""

WIRE_COLUMNS = ("x", "y", "z", "height", "probability")
"""Columns of the thinned points of wires: world coordinates, height above the ground (metres), probability."""

LEAST_LENGTH = 3.0
"""Shorter wires are left out, metres."""

_NEAR = 0.8  # radius of the neighbourhood that gives a direction, metres
_LEAST_POINTS = 8
_LATERAL, _VERTICAL = 0.12, 0.1  # largest distances of the points of a wire from its curve, metres
_GAP = 6.0  # largest gap within a wire, metres
_TRIES, _LEAST_APART = 100, 0.3  # parabolas through three points, and least distance of these, metres
_MOST_SAG = 0.02  # largest curvature of a parabola, 1/m: a span of 40 m with a sag of 4 m
_MOST_BEND, _LEAST_BENT = 0.002, 10.0  # curvature in plan, 1/m (wind, errors of the path), from this length on, metres
_ROUNDS = 5
_SPACING = 1.0  # of the vertices, metres


def wire_probability(evidence: ClassEvidence) -> NDArray[np.float32]:
    """Return the probability of each point of a scene to be a wire, shape (n,); 0 for points without a class."""
    return np.append(evidence.of_groups[:, GROUPS.index("wire")], np.float32(0.0))[evidence.owner]


def no_wire_points() -> pd.DataFrame:
    """Return a table of points of wires without rows."""
    return pd.DataFrame(np.zeros((0, len(WIRE_COLUMNS))), columns=list(WIRE_COLUMNS))


def wire_points(
    xyz: NDArray[np.floating],
    height: NDArray[np.floating],
    probability: NDArray[np.floating],
    *,
    core: NDArray[np.bool_],
    origin: NDArray[np.float64],
) -> pd.DataFrame:
    """Return the points of wires in the core of a scene, thinned to one per cube of `CELL`.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3)
        Coordinates relative to `origin`, metres.
    height : ndarray, shape (n,)
        Height above the ground, metres; NaN where it is not known.
    probability : ndarray, shape (n,)
        Probability to be a wire, see `wire_probability`. Points from `LIKELY` on are kept: thin wires have few points,
        many of which have another class.
    core : ndarray of bool, shape (n,)
        Whether a point belongs to the scene; the others are its buffer.
    origin : ndarray of float64, shape (3,)
        World coordinates of the zero of `xyz`.

    Returns
    -------
    DataFrame
        Columns `WIRE_COLUMNS`, float64: means of the points of each cube, the least height, the mean probability.
    """
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
    """Return the wires of a drive as lines.

    A wire is a parabola in an upright plane, which differs from a catenary by millimetres where the sag is a tenth of
    the span or less. Parabolas through three points along the direction of a neighbourhood are tried; the one with most
    points is fitted again and its points are removed (random sample consensus, Fischler and Bolles 1981).

    Parameters
    ----------
    scenes : sequence of DataFrame
        Points of wires of each scene, of `wire_points`.
    trajectory : Trajectory, optional
        Trajectory that gives the stations.
    least_score : float, default 0.5
        Wires whose points have a lower mean probability are left out. Smaller finds more wires, of which more are
        false.

    Returns
    -------
    DataFrame
        Columns `LINE_FIELDS`.
    """
    filled = [table for table in scenes if len(table)]
    if not filled:
        return line_table([])
    points = np.concatenate([table[list(WIRE_COLUMNS)].to_numpy(dtype=np.float64) for table in filled])
    origin = np.append(np.floor(points[0, :3]), [0.0, 0.0])
    wires = [wire for wire in _Wires(points - origin).found() if wire.score >= least_score]
    return line_table([_row(wire, origin, trajectory) for wire in wires])


@dataclass(frozen=True)
class _Frame:
    """Plan of a wire: the way along a line through `start`, and a bend (square, linear, constant) across it."""

    start: NDArray[np.float64]
    along: NDArray[np.float64]
    bend: NDArray[np.float64]

    def way(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the way of places along the line."""
        way: NDArray[np.float64] = (xy - self.start) @ self.along
        return way

    def apart(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance of places from the curve, across the line."""
        across = (xy - self.start) @ [-self.along[1], self.along[0]]
        return np.abs(across - np.polyval(self.bend, self.way(xy)))

    def fitted(self, xy: NDArray[np.float64]) -> _Frame:
        """Return the line of least squares through places, in the sense of this one, and their bend across it."""
        middle = xy.mean(axis=0)
        along = np.linalg.svd(xy - middle, full_matrices=False)[2][0]
        along = along if along @ self.along > 0 else -along
        way, across = (xy - middle) @ along, (xy - middle) @ [-along[1], along[0]]
        bend = np.polyfit(way, across, 2) if np.ptp(way) > _LEAST_BENT else np.zeros(3)
        return _Frame(middle, along, bend if abs(bend[0]) < _MOST_BEND else np.zeros(3))


@dataclass(frozen=True)
class _Wire:
    """Curve of a wire: its plan, heights and ends along it; least height above the ground, mean probability."""

    frame: _Frame
    curve: NDArray[np.float64]
    ends: tuple[float, float]
    clearance: float
    score: float

    def at(self, way: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places on the curve."""
        along, across = self.frame.along, np.polyval(self.frame.bend, way)
        xy = self.frame.start + way[:, None] * along + across[:, None] * np.array([-along[1], along[0]])
        return np.column_stack([xy, np.polyval(self.curve, way)])


class _Wires:
    """Points of wires that are not yet part of one."""

    def __init__(self, points: NDArray[np.float64]) -> None:
        self.points = points
        self.free = np.ones(len(points), dtype=bool)
        self.tree = cKDTree(points[:, :3])
        self.random = np.random.default_rng(len(points))

    def found(self) -> list[_Wire]:
        """Return the wires, from the one with the straightest neighbourhood on."""
        wires = []
        along, straightness = self._directions()
        for seed in np.argsort(-straightness, kind="stable"):
            if not self.free[seed] or straightness[seed] <= 0:
                continue
            wire = self._grown(int(seed), along[seed])
            if wire is not None:
                wires.append(wire)
        return wires

    def _directions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return direction in plan and straightness of the neighbourhood of each point."""
        pairs = self.tree.query_pairs(_NEAR, output_type="ndarray")
        first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
        apart = self.points[second, :2] - self.points[first, :2]
        apart *= np.where(apart @ [1.0, 1e-6] < 0, -1.0, 1.0)[:, None]
        n = len(self.points)
        xx, yy, xy = (np.bincount(first, apart[:, a] * apart[:, b], minlength=n) for a, b in ((0, 0), (1, 1), (0, 1)))
        angle = np.arctan2(2 * xy, xx - yy) / 2
        spread = np.hypot(xx - yy, 2 * xy)
        enough = np.bincount(first, minlength=n) >= 3
        straight = np.where(enough, spread / np.maximum(xx + yy, 1e-12), 0.0)
        return np.column_stack([np.cos(angle), np.sin(angle)]), straight * np.sqrt(np.bincount(first, minlength=n))

    def _grown(self, seed: int, along: NDArray[np.float64]) -> _Wire | None:
        """Return the wire through a point; its points are taken. Without a wire, the point alone is."""
        self.free[seed] = False
        everything = np.append(np.flatnonzero(self.free), seed)
        frame = _Frame(self.points[seed, :2], along, np.zeros(3))
        for _ in range(_ROUNDS):
            rows, curve = self._consensus(everything, seed, frame)
            if len(rows) < _LEAST_POINTS or np.ptp(frame.way(self.points[rows, :2])) < _NEAR:
                return None
            frame = frame.fitted(self.points[rows, :2])
        rows, curve = self._consensus(everything, seed, frame)
        if len(rows) < _LEAST_POINTS:
            return None
        way = frame.way(self.points[rows, :2])
        if np.ptp(way) < LEAST_LENGTH:
            return None
        self.free[rows] = False
        self._take_beside(frame, curve, way)
        heights = self.points[rows, 3]
        lowest = float(np.nanmin(heights)) if np.isfinite(heights).any() else np.nan
        return _Wire(frame, curve, (float(way.min()), float(way.max())), lowest, float(self.points[rows, 4].mean()))

    def _take_beside(self, frame: _Frame, curve: NDArray[np.float64], span: NDArray[np.float64]) -> None:
        """Take the points up to twice as far from a wire: noise, of which no second wire is to be made."""
        rows = np.flatnonzero(self.free)
        way = frame.way(self.points[rows, :2])
        near = (frame.apart(self.points[rows, :2]) < 2 * _LATERAL) & (way > span.min()) & (way < span.max())
        near &= np.abs(self.points[rows, 2] - np.polyval(curve, way)) < 2 * _VERTICAL
        self.free[rows[near]] = False

    def _consensus(
        self, rows: NDArray[np.int64], seed: int, frame: _Frame
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
        first, second = self.random.integers(len(way), size=(2, _TRIES))
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


def _row(wire: _Wire, origin: NDArray[np.float64], trajectory: Trajectory | None) -> dict[str, object]:
    low, high = wire.ends
    way = np.linspace(low, high, max(3, int(np.ceil((high - low) / _SPACING)) + 1))
    vertices = wire.at(way)
    chord = np.interp(way, [low, high], vertices[[0, -1], 2])
    vertices += origin[:3]
    measures = {"sag": float(max((chord - vertices[:, 2] + origin[2]).max(), 0.0)), "clearance": wire.clearance}
    measures["score"] = wire.score
    return line_row("wire", vertices, trajectory, **measures)
