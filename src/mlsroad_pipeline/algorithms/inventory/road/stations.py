"""Stations of a road: a smooth path, and the place of points along and across it, for each pass of the path."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

STEP = 1.0
"""Length of a station along the path, metres."""
REACH = 20.0
"""Largest distance of points from the path, metres."""

_SMOOTH = 1.5  # standard deviation of the weights of positions, metres: headings of recorded paths jitter
_PIECE = 60  # stations that are located together
_AHEAD = 30  # metres of path before and after a piece that its points may be nearer to
_LEAST_STEP, _MOST_BACK = 1.0, 0.05  # metres: standing vehicles jitter; share of steps that may turn back


class Located(NamedTuple):
    """Places of points along the path; a point beside two passes has two."""

    row: NDArray[np.int64]  # Row of the point
    station: NDArray[np.float64]  # Metres
    offset: NDArray[np.float64]  # Metres, positive to the right


def check_driven(trajectory: Trajectory) -> None:
    """Raise DataError where steps turn back, as between the rows of a table that is no path."""
    last, kept = -np.inf, []
    for row, station in enumerate(trajectory.station.tolist()):
        if station - last >= _LEAST_STEP:
            last = station
            kept.append(row)
    step = np.diff(trajectory.xyz[kept, :2], axis=0)
    back = np.flatnonzero((step[1:] * step[:-1]).sum(axis=1) < 0)
    if len(back) > max(1, _MOST_BACK * (len(step) - 1)):
        x, y = trajectory.xyz[kept[back[0] + 1], :2]
        raise DataError(
            f"{trajectory.source} is not a path: {len(back)} of {len(step) - 1} steps turn back by more than 90 "
            f"degrees, the first at {x:.2f}, {y:.2f}; name the positions of the vehicle in the order of travel"
        )


@dataclass(frozen=True)
class RoadPath:
    """Path of a survey as a smooth line with a vertex per station."""

    xyz: NDArray[np.float64]  # Vertices, world coordinates
    station: NDArray[np.float64]  # Their stations along the recorded path, metres

    @classmethod
    def along(cls, trajectory: Trajectory) -> "RoadPath":
        """Return the smooth path of a trajectory, which keeps its stations."""
        if trajectory.length < STEP:
            raise DataError(f"{trajectory.source}: the path is {trajectory.length:.2f} m long, shorter than a station")
        station = np.arange(int(trajectory.length / STEP) + 1, dtype=np.float64) * STEP
        moving = np.append(True, np.diff(trajectory.station) > 0)
        fine = np.arange(0.0, station[-1] + STEP / 8, STEP / 4)
        known = [np.interp(fine, trajectory.station[moving], axis[moving]) for axis in trajectory.xyz.T]
        # The straight part that is added at both ends keeps the ends in place.
        ends = [np.concatenate([2 * v[0] - v[24:0:-1], v, 2 * v[-1] - v[-2:-26:-1]]) for v in known]
        full = len(fine) > 25
        smooth = [
            gaussian_filter1d(v, _SMOOTH * 4 / STEP)[24:-24] if full else k for v, k in zip(ends, known, strict=True)
        ]
        return cls(np.column_stack(smooth)[::4], station)

    def __len__(self) -> int:
        """Return the number of whole stations."""
        return len(self.station) - 1

    @cached_property
    def middles(self) -> NDArray[np.float64]:
        """Middles of the stations, world coordinates, shape (n, 3)."""
        return (self.xyz[1:] + self.xyz[:-1]) / 2

    @cached_property
    def forward(self) -> NDArray[np.float64]:
        """Direction of the path in each station, in plan, shape (n, 2)."""
        step = np.diff(self.xyz[:, :2], axis=0)
        return step / np.maximum(np.hypot(*step.T), 1e-9)[:, None]

    def across(self, station: NDArray[np.int64], offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the places in plan beside the middles of stations."""
        right = np.column_stack([self.forward[:, 1], -self.forward[:, 0]])[station]
        return self.middles[station, :2] + right * np.asarray(offset)[:, None]

    @cached_property
    def _pieces(self) -> list[tuple[float, float, NDArray[np.float64], Trajectory]]:
        found = []
        for first in range(0, len(self), _PIECE):
            last = min(first + _PIECE, len(self))
            near = slice(max(first - _AHEAD, 0), last + _AHEAD + 1)
            own = self.xyz[first : last + 1, :2]
            box = np.array([own.min(axis=0) - REACH, own.max(axis=0) + REACH])
            part = Trajectory(None, self.xyz[near], self.station[near])
            found.append((self.station[first], self.station[last], box, part))
        return found

    def locate(self, xyz: NDArray[np.float64]) -> Located:
        """Return the places of points within `REACH` of the path; each pass of the path has its own."""
        rows, stations, offsets = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros(0)]
        if len(xyz):
            low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
            for first, last, box, part in self._pieces:
                if (high < box[0]).any() or (low > box[1]).any():
                    continue
                row = np.flatnonzero(((xyz[:, :2] >= box[0]) & (xyz[:, :2] <= box[1])).all(axis=1))
                station, offset = part.locate(xyz[row])
                own = (station >= first) & (station < last) & (np.abs(offset) < REACH)
                rows.append(row[own])
                stations.append(station[own])
                offsets.append(offset[own])
        return Located(np.concatenate(rows), np.concatenate(stations), np.concatenate(offsets))
