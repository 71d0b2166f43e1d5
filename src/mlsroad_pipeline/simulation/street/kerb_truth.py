"""True kerbs of a simulated street."""

from __future__ import annotations

import contourpy
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.street.street import Street

STEP = 0.1
"""Spacing of the vertices, metres."""

_ALONG, _ACROSS = 0.2, 0.1  # grid of the distance to the curb line, metres
_FOOT, _TOP = -0.02, 0.06  # places on both sides of the face, metres from the curb line
_TINY = 0.01  # metres, for directions


def true_kerbs(street: Street, *, start: float, end: float, reach: float = 45.0) -> NDArray[np.float64]:
    """Return places along the foot of all kerbs between two stations, also where they are dropped to road height."""
    along, across = np.arange(start, end, _ALONG), np.arange(-reach, reach, _ACROSS)
    distance, _ = street.ground.edge(along[None, :], across[:, None])
    lines = contourpy.contour_generator(along, across, distance).lines(0.0)
    places = [_resampled(np.asarray(line, dtype=np.float64)) for line in lines]
    parts = [_described(street, line) for line in places if len(line)]
    return np.concatenate(parts) if parts else np.zeros((0, 4))


def _resampled(line: NDArray[np.float64]) -> NDArray[np.float64]:
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(STEP / 2, way[-1], STEP)
    return np.column_stack([np.interp(at, way, line[:, k]) for k in range(2)])


def _described(street: Street, line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places and heights; the kerb rises in the direction in which the distance to its line grows."""
    ground, (s, left) = street.ground, line.T
    rise = np.column_stack(
        [
            ground.edge(s + _TINY, left)[0] - ground.edge(s - _TINY, left)[0],
            ground.edge(s, left + _TINY)[0] - ground.edge(s, left - _TINY)[0],
        ]
    )
    rise /= np.maximum(np.hypot(*rise.T), 1e-9)[:, None]
    foot = ground.height(*(line + _FOOT * rise).T)
    height = ground.height(*(line + _TOP * rise).T) - foot
    return np.column_stack([street.alignment.place(s, left)[0], foot, height])
