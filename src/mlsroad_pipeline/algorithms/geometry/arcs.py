"""Smooth line of straight pieces and arcs through positions, and places along and beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

_STRAIGHT = 1e-9  # curvature, 1/m
_BEYOND, _AT_END = 1e-4, 1e-6  # metres
_SAMPLE = 1.0  # of the line, for the search of the nearest piece, metres


class Pieces(NamedTuple):
    """Columns of pieces, each of a constant curvature: start, heading there, curvature and length."""

    xy: NDArray[np.float64]
    heading: NDArray[np.float64]
    curvature: NDArray[np.float64]
    length: NDArray[np.float64]

    def of(self, rows: NDArray[np.int64]) -> Pieces:
        """Return the pieces of rows."""
        return Pieces(*(column[rows] for column in self))


@dataclass(frozen=True)
class ArcLine:
    """Line of arcs without kinks; headings are counterclockwise from x, radians."""

    pieces: Pieces
    starts: NDArray[np.float64]  # Way along the line at the start of each piece, metres
    nodes: NDArray[np.float64]  # Way at each of the positions that it leads through

    @classmethod
    def through(cls, xy: ArrayLike, *, before: float = 0.0, after: float = 0.0) -> ArcLine:
        """Return a line through two or more different positions, two arcs between each pair of neighbours.

        `before` and `after` are lengths of straight pieces at its ends, metres.
        """
        points = np.asarray(xy, np.float64)
        tangents = _tangents(points)
        parts = [_biarcs(points, tangents)]
        if before > 0:
            parts.insert(0, _straight(points[:1] - tangents[:1] * before, tangents[:1], before))
        if after > 0:
            parts.append(_straight(points[-1:], tangents[-1:], after))
        pieces = Pieces(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        starts = np.concatenate([[0.0], np.cumsum(pieces.length)])
        first = int(before > 0)
        return cls(pieces, starts[:-1], starts[first : first + 2 * len(points) - 1 : 2])

    @classmethod
    def beside(cls, xy: ArrayLike, places: ArrayLike) -> ArcLine:
        """Return a line through positions that goes straight on at its ends until all places are beside it."""
        line, before, after = cls.through(xy), 0.0, 0.0
        while max(more := line._beyond(np.asarray(places, np.float64).reshape(-1, 2))) > _BEYOND:
            before, after = before + more[0], after + more[1]
            line = cls.through(xy, before=before, after=after)
        return line

    @property
    def length(self) -> float:
        """Length, metres."""
        return float(self.starts[-1] + self.pieces.length[-1])

    def at(self, way: ArrayLike, side: ArrayLike = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the places at ways along the line and distances to its left, and the headings of the line there."""
        along = np.atleast_1d(np.asarray(way, np.float64))
        rows = np.clip(np.searchsorted(self.starts, along, side="right") - 1, 0, len(self.starts) - 1)
        foot, heading = _moved(self.pieces.of(rows), along - self.starts[rows])
        left = np.column_stack([-np.sin(heading), np.cos(heading)])
        return foot + left * np.asarray(side, np.float64).reshape(-1, 1), heading

    def locate(self, xy: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return way along the line and distance to the left of places; beyond its ends those of the end.

        The foot is that of the piece that is nearest, or of one beside it.
        """
        points = np.asarray(xy, np.float64).reshape(-1, 2)
        ways = np.unique(np.concatenate([np.arange(0.0, self.length, _SAMPLE), self.starts, [self.length]]))
        nearest = ways[cKDTree(self.at(ways)[0]).query(points)[1]]
        own = np.searchsorted(self.starts, nearest, side="right") - 1
        best, way, side = np.full(len(points), np.inf), np.zeros(len(points)), np.zeros(len(points))
        for step in (0, -1, 1):
            rows = np.clip(own + step, 0, len(self.starts) - 1)
            pieces = self.pieces.of(rows)
            along = _foot(pieces, points)
            foot, heading = _moved(pieces, along)
            gap = points - foot
            distance = np.hypot(*gap.T)
            closer = distance < best
            across = np.cos(heading) * gap[:, 1] - np.sin(heading) * gap[:, 0]
            best = np.where(closer, distance, best)
            way, side = np.where(closer, self.starts[rows] + along, way), np.where(closer, across, side)
        return way, side

    def _beyond(self, points: NDArray[np.float64]) -> tuple[float, float]:
        """Return how far places lie before the start and after the end, metres."""
        way, _ = self.locate(points)
        ends, heading = self.at([0.0, self.length])
        ahead = (points[:, None] - ends) * np.stack([np.cos(heading), np.sin(heading)], 1)
        before, after = ahead.sum(axis=2).T * [[-1.0], [1.0]]
        at_start, at_end = way < _AT_END, way > self.length - _AT_END
        return float(before[at_start].max(initial=0.0)), float(after[at_end].max(initial=0.0))


def spread(xy: ArrayLike, spacing: float) -> NDArray[np.int64]:
    """Return the rows of positions at least a distance from the last one before, and the last row.

    Of positions that lie all within this distance, the first and the one farthest from it.
    """
    points: list[list[float]] = np.asarray(xy, np.float64).tolist()
    kept, end = [0], len(points) - 1
    for row, point in enumerate(points):
        if math.dist(point, points[kept[-1]]) >= spacing:
            kept.append(row)
    if len(kept) == 1:
        return np.array([0, max(range(len(points)), key=lambda row: math.dist(points[row], points[0]))])
    if math.dist(points[end], points[kept[-1]]) < spacing / 2:
        kept[-1] = end
    elif kept[-1] != end:
        kept.append(end)
    return np.array(kept)


def _tangents(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit tangents: bisectors of the chords, across them where the line turns back."""
    chords = np.diff(points, axis=0)
    chords = chords / np.hypot(*chords.T)[:, None]
    inner = chords[:-1] + chords[1:]
    back = np.hypot(*inner.T) < 1e-6
    inner[back] = np.column_stack([-chords[:-1][back, 1], chords[:-1][back, 0]])
    whole = np.vstack([chords[:1], inner, chords[-1:]])
    unit: NDArray[np.float64] = whole / np.hypot(*whole.T)[:, None]
    return unit


def _biarcs(points: NDArray[np.float64], tangents: NDArray[np.float64]) -> Pieces:
    """Return two arcs of equal tangent lengths between each pair of neighbours."""
    chord, first, last = np.diff(points, axis=0), tangents[:-1], tangents[1:]
    both, turn = first + last, 2.0 * (1.0 - (first * last).sum(axis=1))
    c, b = (chord * chord).sum(axis=1), (chord * both).sum(axis=1)
    # Root of turn d^2 + 2 b d - c, in the form that stays finite where the tangents are equal
    reach = (c / (b + np.sqrt(b * b + turn * c)))[:, None]
    middle = (points[:-1] + first * reach + points[1:] - last * reach) / 2.0
    begins = np.stack([points[:-1], middle], 1).reshape(-1, 2)
    ends = np.stack([middle, points[1:]], 1).reshape(-1, 2)
    to = ends - begins
    size, of_chord = np.hypot(*to.T), np.arctan2(to[:, 1], to[:, 0])
    starts = np.arctan2(first[:, 1], first[:, 0])
    half = np.empty(len(to))
    half[0::2] = _wrapped(of_chord[0::2] - starts)
    half[1::2] = _wrapped(np.arctan2(last[:, 1], last[:, 0]) - of_chord[1::2])
    curvature = 2.0 * np.sin(half) / size
    length = size / np.sinc(half / np.pi)
    return Pieces(begins, of_chord - half, curvature, length)


def _straight(start: NDArray[np.float64], tangent: NDArray[np.float64], length: float) -> Pieces:
    return Pieces(start, np.arctan2(tangent[:, 1], tangent[:, 0]), np.zeros(1), np.array([length]))


def _moved(pieces: Pieces, way: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return place and heading at ways along pieces."""
    half = pieces.curvature * way / 2.0
    chord, middle = way * np.sinc(half / np.pi), pieces.heading + half
    place = pieces.xy + chord[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
    return place, pieces.heading + 2.0 * half


def _foot(pieces: Pieces, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the way along each piece to the place that is nearest to a point."""
    gap = points - pieces.xy
    cos, sin = np.cos(pieces.heading), np.sin(pieces.heading)
    along, left = gap[:, 0] * cos + gap[:, 1] * sin, gap[:, 1] * cos - gap[:, 0] * sin
    k = np.where(np.abs(pieces.curvature) < _STRAIGHT, 1.0, pieces.curvature)
    around = 2.0 * np.pi / np.abs(k)
    way = np.mod(np.arctan2(k * along, 1.0 - k * left) / k, around)
    way = np.where(way - pieces.length > around - way, 0.0, way)  # nearer to the start than to the end
    way = np.where(np.abs(pieces.curvature) < _STRAIGHT, along, way)
    clipped: NDArray[np.float64] = np.clip(way, 0.0, pieces.length)
    return clipped


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    wrapped: NDArray[np.float64] = np.mod(angle + np.pi, 2.0 * np.pi) - np.pi
    return wrapped
