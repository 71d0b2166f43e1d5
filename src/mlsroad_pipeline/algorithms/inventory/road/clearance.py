"""Clearance: lowest points above the carriageway and in an envelope around the path, with their objects."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.road.stations import REACH, STEP, Located
from mlsroad_pipeline.algorithms.inventory.road.surface import CELL, CELLS, Planes

LOWEST, HIGHEST = 2.0, 12.0
"""Heights above the road within which clearance is measured, metres."""
FROM = 0.3
"""Height above the road from which on points are inside an envelope, metres."""
BESIDE = 1.75
"""Distance from the path up to which clearance is measured where an edge is not seen, metres."""

_WIDTH = 0.25  # of a cell across the path, metres
_CELLS = round(2 * REACH / _WIDTH)
_KEPT = 4  # lowest points of a cell that are kept
_SUPPORT, _NEAR = 3, 0.25  # points in neighbouring cells, itself included, that differ in height by at most so much


class Lowest(NamedTuple):
    """Lowest points by station and cell across, in the order of their height; infinite where there are fewer."""

    height: NDArray[np.float32]  # Above the road, (stations, _CELLS, _KEPT)
    label: NDArray[np.uint8]  # Class
    number: NDArray[np.uint32]  # Object, 0 without one

    @classmethod
    def empty(cls, stations: int) -> "Lowest":
        """Return the lowest points before the first one."""
        size = (stations, _CELLS, _KEPT)
        return cls(np.full(size, np.inf, np.float32), np.zeros(size, np.uint8), np.zeros(size, np.uint32))

    def add(
        self, places: Located, height: NDArray[np.float64], label: NDArray[np.uint8], number: NDArray[np.uint32]
    ) -> None:
        """Add points, in place."""
        _keep(places.station / STEP, places.offset, height, label, number, *self)


@njit(cache=True, nogil=True)
def _keep(
    station: NDArray, offset: NDArray, height: NDArray, label: NDArray, number: NDArray,
    heights: NDArray, labels: NDArray, numbers: NDArray,
) -> None:  # fmt: skip
    """Insert each point among the lowest ones of its cell."""
    for p in range(len(station)):
        i, c = int(station[p]), int((offset[p] + REACH) / _WIDTH)
        if not (0 <= i < len(heights) and 0 <= c < _CELLS) or height[p] >= heights[i, c, _KEPT - 1]:
            continue
        k = _KEPT - 1
        while k > 0 and height[p] < heights[i, c, k - 1]:
            heights[i, c, k], labels[i, c, k], numbers[i, c, k] = (
                heights[i, c, k - 1], labels[i, c, k - 1], numbers[i, c, k - 1],
            )  # fmt: skip
            k -= 1
        heights[i, c, k], labels[i, c, k], numbers[i, c, k] = height[p], label[p], number[p]


class Lowered(NamedTuple):
    """Lowest supported point of each station: height, offset, class (-1 without one) and object."""

    height: NDArray[np.float64]
    offset: NDArray[np.float64]
    label: NDArray[np.int64]
    number: NDArray[np.int64]


def lowest_points(lowest: Lowest) -> Lowered:
    """Return the lowest point of each station that has others beside it; single ones are stray."""
    cell, rank = _supported(lowest.height).T
    rows, there = np.arange(len(cell)), cell >= 0
    height = np.where(there, lowest.height[rows, cell, rank], np.nan).astype(np.float64)
    offset = np.where(there, (cell + 0.5) * _WIDTH - REACH, np.nan)
    label = np.where(there, lowest.label[rows, cell, rank].astype(np.int64), -1)
    return Lowered(height, offset, label, np.where(there, lowest.number[rows, cell, rank].astype(np.int64), 0))


@njit(cache=True, nogil=True)
def _supported(heights: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return cell and rank of the lowest point of each station that others support; -1 without one."""
    n = len(heights)
    out = np.full((n, 2), -1)
    for i in range(n):
        best = np.inf
        for c in range(_CELLS):
            for k in range(_KEPT):
                height = heights[i, c, k]
                if height >= best:
                    break
                near = 0
                for a in range(max(i - 1, 0), min(i + 2, n)):
                    for b in range(max(c - 1, 0), min(c + 2, _CELLS)):
                        for m in range(_KEPT):
                            near += abs(heights[a, b, m] - height) <= _NEAR
                if near >= _SUPPORT:
                    best, out[i, 0], out[i, 1] = height, c, k
                    break
    return out


def above_road(
    places: Located, z: NDArray[np.float64], surface: NDArray[np.float64], planes: Planes
) -> NDArray[np.float64]:
    """Return the heights of points above the road below them; NaN where the road is not known."""
    at = (places.station / STEP).astype(np.int64)
    cell = np.clip(((places.offset + REACH) / CELL).astype(np.int64), 0, CELLS - 1)
    return np.asarray(z - surface[at, cell] - planes.slope[at] * (places.station - (at + 0.5) * STEP))
