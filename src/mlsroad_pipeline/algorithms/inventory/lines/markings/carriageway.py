"""Places beyond a kerb, seen from the path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


def beyond_kerb(
    places: NDArray[np.float64], kerbs: Sequence[NDArray[np.float64]], trajectory: Trajectory
) -> NDArray[np.bool_]:
    """Return which places are higher up than the path by one kerb or more.

    Kerbs between a place and the nearest position of the path are counted, upward ones less downward ones: the second
    carriageway behind a median is on the level of the first.
    """
    if len(places) == 0 or not kerbs:
        return np.zeros(len(places), dtype=bool)
    station = np.clip(trajectory.locate(places)[0], 0.0, trajectory.length)
    origin = places[0, :2]
    start = np.column_stack([np.interp(station, trajectory.station, trajectory.xyz[:, k]) for k in range(2)]) - origin
    way = places[:, :2] - origin - start
    first, last = (np.concatenate([line[part, :2] for line in kerbs]) - origin for part in (slice(-1), slice(1, None)))
    along = last - first
    up = np.zeros(len(places), dtype=np.int64)
    for k in range(len(places)):
        turn = along[:, 0] * way[k, 1] - along[:, 1] * way[k, 0]
        apart = first - start[k]
        with np.errstate(divide="ignore", invalid="ignore"):  # parallel ones do not meet
            share = (apart[:, 1] * along[:, 0] - apart[:, 0] * along[:, 1]) / turn
            part = (apart[:, 1] * way[k, 0] - apart[:, 0] * way[k, 1]) / turn
        meets = (share > 0) & (share < 1) & (part >= 0) & (part < 1)
        up[k] = int(np.sign(turn[meets]).sum())
    return up > 0
