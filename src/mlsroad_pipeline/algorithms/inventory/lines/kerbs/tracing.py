"""Lines through the steps of the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.lines.kerbs.steps import Steps

STRIDES = (0.4, 0.8, 1.2, 1.6, 2.0)
"""Distances at which a line is continued, metres; the last is the largest gap."""

SHORT_LINE, SHORT_STRIDES = 3, 3
"""Lines of fewer vertices in one direction are continued at the first strides alone: their direction is uncertain."""

_REACH, _LATERAL = 0.3, 0.2  # metres around the expected place
_TAKEN = 0.35  # steps this near to a line belong to it, metres


def trace_lines(steps: Steps, *, least_length: float) -> list[NDArray[np.float64]]:
    """Return lines through steps, with the upper side on the left.

    From the clearest step on, a line is continued in both directions to the mean of the steps ahead whose edges run the
    same way.
    """
    if len(steps.height) == 0:
        return []
    tracer = _Tracer(steps)
    lines = [tracer.line(i) for i in np.argsort(-tracer.weight, kind="stable") if tracer.free[i]]
    return [line for line in lines if len(line) > 1 and _length(line) >= least_length]


def _length(line: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())


class _Tracer:
    """Steps that are not yet part of a line."""

    def __init__(self, steps: Steps) -> None:
        self.origin = steps.xyz[0, :2].copy()
        self.place = steps.xyz[:, :2] - self.origin
        self.along = np.column_stack([steps.upward[:, 1], -steps.upward[:, 0]])
        self.values = np.column_stack([steps.xyz, steps.height])
        self.weight = steps.height / (steps.roughness + 0.01)
        self.free = np.ones(len(self.place), dtype=bool)
        self.tree = cKDTree(self.place)

    def line(self, start: int) -> NDArray[np.float64]:
        """Return the vertices of the line through a step, and take its steps."""
        self._take(self.place[start], self.along[start])
        first = self._vertex(np.array([start]))
        ahead = self._way(start, 1.0)
        back = self._way(start, -1.0)
        return np.array([*back[::-1], first, *ahead])

    def _vertex(self, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        weight = self.weight[rows, None]
        return np.asarray((self.values[rows] * weight).sum(axis=0) / weight.sum())

    def _take(self, place: NDArray[np.float64], along: NDArray[np.float64]) -> None:
        rows = np.array(self.tree.query_ball_point(place, _TAKEN, return_sorted=True), dtype=np.int64)
        self.free[rows[self.along[rows] @ along > 0.6]] = False

    def _way(self, start: int, sign: float) -> list[NDArray[np.float64]]:
        place, along = self.place[start], sign * self.along[start]
        vertices: list[NDArray[np.float64]] = []
        while True:
            rows = self._ahead(place, along, sign, STRIDES[: SHORT_STRIDES if len(vertices) < SHORT_LINE else None])
            if rows is None:
                return vertices
            vertex = self._vertex(rows)
            moved = vertex[:2] - self.origin - place
            turned = sign * (self.along[rows] * self.weight[rows, None]).sum(axis=0)
            along = 0.4 * moved / np.hypot(*moved) + 0.6 * turned / np.hypot(*turned)
            along /= np.hypot(*along)
            for share in np.linspace(0.0, 1.0, 1 + int(np.ceil(np.hypot(*moved) / _TAKEN)))[1:]:
                self._take(place + share * moved, sign * along)
            place = place + moved
            vertices.append(vertex)

    def _ahead(
        self, place: NDArray[np.float64], along: NDArray[np.float64], sign: float, strides: tuple[float, ...]
    ) -> NDArray[np.int64] | None:
        """Return the steps that continue a line, None at its end."""
        across = np.array([-along[1], along[0]])
        for stride in strides:
            rows = np.array(
                self.tree.query_ball_point(place + stride * along, _REACH, return_sorted=True), dtype=np.int64
            )
            apart = self.place[rows] - place
            fits = self.free[rows] & (sign * self.along[rows] @ along > 0.85) & (apart @ along > 0.1)
            fits &= np.abs(apart @ across) < _LATERAL * max(1.0, stride / 0.8)
            if fits.any():
                return rows[fits]
        return None
