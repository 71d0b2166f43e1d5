"""Lines through bright stripes."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.lines.markings.stripes import Stripes

STRIDES = (0.3, 0.6, 0.9, 1.2)
"""Distances at which a line is continued, metres; the last is the largest gap within a line."""

LEAST_START = 6.0
"""Clearness from which a stripe begins a line, standard errors."""

_REACH, _LATERAL = 0.2, 0.12  # metres around the expected place
_SAME_WAY, _TAKEN_WAY = 0.94, 0.6  # cosines
_BEYOND = 0.1  # metres from the mean of the last stripes to the end of a line
_TAKEN = 0.2  # stripes this near to the edge of a line belong to it, metres


def trace_markings(stripes: Stripes, *, least_length: float) -> list[NDArray[np.float64]]:
    """Return lines through stripes.

    From the clearest stripe on, a line is continued in both directions to the mean of the stripes ahead that run the
    same way.
    """
    if len(stripes.width) == 0:
        return []
    tracer = _Tracer(stripes)
    lines = []
    for i in np.argsort(-stripes.clearness, kind="stable"):
        if stripes.clearness[i] < LEAST_START:
            break
        if tracer.free[i]:
            line = tracer.line(i)
            if len(line) > 1 and line_length(line) >= least_length:
                lines.append(line)
    return lines


def line_length(line: NDArray[np.float64]) -> float:
    """Return the length of a line in plan, metres."""
    return float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())


def _lengthened(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a line whose end vertices, means of the stripes around them, are moved outwards."""
    if len(line) < 2:
        return line
    longer = line.copy()
    for end, beside in ((0, 1), (-1, -2)):
        step = line[end, :3] - line[beside, :3]
        longer[end, :3] += step * _BEYOND / np.hypot(*step[:2])
    return longer


class _Tracer:
    """Stripes that are not yet part of a line."""

    def __init__(self, stripes: Stripes) -> None:
        self.origin = stripes.xyz[0, :2].copy()
        self.place, self.along = stripes.xyz[:, :2] - self.origin, stripes.along
        self.values = np.column_stack([stripes.xyz, stripes.width, stripes.contrast, stripes.clearness])
        self.weight = stripes.clearness
        self.free = np.ones(len(self.place), dtype=bool)
        self.tree = cKDTree(self.place)

    def line(self, start: int) -> NDArray[np.float64]:
        """Return the vertices of the line through a stripe, and take its stripes."""
        first, along = self._vertex(self._near(self.place[start], self.along[start]), self.along[start])
        self._take(first, along)
        ahead, back = self._way(first, along), self._way(first, -along)
        return _lengthened(np.array([*back[::-1], first, *ahead]))

    def _near(self, at: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.int64]:
        rows = np.array(self.tree.query_ball_point(at, _REACH, return_sorted=True), dtype=np.int64)
        return rows[self.free[rows] & (np.abs(self.along[rows] @ along) > _SAME_WAY)]

    def _vertex(
        self, rows: NDArray[np.int64], along: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the mean of stripes and their direction, of the sign of `along`."""
        weight = self.weight[rows, None]
        turned = (self.along[rows] * np.sign(self.along[rows] @ along)[:, None] * weight).sum(axis=0)
        return (self.values[rows] * weight).sum(axis=0) / weight.sum(), turned / np.hypot(*turned)

    def _take(self, vertex: NDArray[np.float64], along: NDArray[np.float64]) -> None:
        at, half = vertex[:2] - self.origin, vertex[3] / 2
        rows = np.array(self.tree.query_ball_point(at, 0.3 + half, return_sorted=True), dtype=np.int64)
        across = np.abs((self.place[rows] - at) @ (-along[1], along[0]))
        self.free[rows[(across < _TAKEN + half) & (np.abs(self.along[rows] @ along) > _TAKEN_WAY)]] = False

    def _way(self, first: NDArray[np.float64], along: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        last = first
        vertices: list[NDArray[np.float64]] = []
        while True:
            rows = self._ahead(last[:2] - self.origin, along)
            if len(rows) == 0:
                return vertices
            vertex, turned = self._vertex(rows, along)
            moved = vertex[:2] - last[:2]
            along = 0.5 * moved / np.hypot(*moved) + 0.5 * turned
            along /= np.hypot(*along)
            for share in np.linspace(0.0, 1.0, 1 + int(np.ceil(np.hypot(*moved) / 0.25)))[1:]:
                self._take(last + share * (vertex - last), along)
            vertices.append(vertex)
            last = vertex

    def _ahead(self, at: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the stripes that continue a line, none at its end."""
        for stride in STRIDES:
            rows = self._near(at + stride * along, along)
            apart = self.place[rows] - at
            across = np.abs(apart @ (-along[1], along[0]))
            rows = rows[(apart @ along > 0.1) & (across < _LATERAL * max(1.0, stride / 0.6))]
            if len(rows):
                return rows
        return np.zeros(0, dtype=np.int64)
