"""Corridor that a survey is cut along: its trajectory or the main axis of its points."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


@dataclass(frozen=True)
class MainAxis:
    """Straight corridor, for surveys without a trajectory."""

    centre: NDArray[np.float64]  # Point on the axis, world coordinates, metres
    direction: NDArray[np.float64]  # Unit vector along the axis

    def locate(
        self, xyz: ArrayLike, *, origin: ArrayLike = (0.0, 0.0, 0.0)
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return station and offset of points relative to the axis."""
        points = check_xyz(xyz)
        shift = np.asarray(origin, dtype=np.float64)[:2] - self.centre
        x, y = points[:, 0] + shift[0], points[:, 1] + shift[1]
        ux, uy = self.direction
        return x * ux + y * uy, x * uy - y * ux


Corridor: TypeAlias = Trajectory | MainAxis | None
"""Corridor of a survey; without one (None) each file is one bin."""


def main_axis(xyz: ArrayLike) -> MainAxis:
    """Return the first principal axis of points in plan."""
    points = check_xyz(xyz, minimum=2)[:, :2].astype(np.float64)
    centre = points.mean(axis=0)
    moved = points - centre
    values, vectors = np.linalg.eigh(moved.T @ moved / len(moved))
    if values[1] <= 0.0:
        raise DataError(f"{len(points)} points coincide in plan ({centre.tolist()}): they have no main axis")
    direction = vectors[:, 1]
    sign = 1.0 if (direction[0], direction[1]) > (0.0, 0.0) else -1.0
    return MainAxis(centre, direction * sign)


def axis_of_samples(samples: Sequence[PointCloud]) -> MainAxis | None:
    """Return the main axis of a survey from samples of its files."""
    points = np.concatenate([sample.world_xyz() for sample in samples])
    if len(points) < 2 or np.ptp(points[:, :2], axis=0).max() == 0.0:
        return None
    return main_axis(points)


class CorridorArrays(TypedDict, total=False):
    """A stored corridor: the arrays of a trajectory, of a main axis, or `none`."""

    trajectory: NDArray[np.float64]  # (n, 3): points of the trajectory, metres
    station: NDArray[np.float64]  # (n,): stations of its points, metres
    time: NDArray[np.float64]  # (n,): times of its points, seconds; empty without times
    centre: NDArray[np.float64]  # (2,): point of the main axis in plan, metres
    direction: NDArray[np.float64]  # (2,): direction of the main axis in plan
    none: NDArray[np.float64]  # empty


def corridor_to_arrays(corridor: Corridor) -> CorridorArrays:
    """Return a corridor as named arrays for storage."""
    if isinstance(corridor, Trajectory):
        times = np.zeros(0) if corridor.time is None else corridor.time
        return {"trajectory": corridor.xyz, "station": corridor.station, "time": times}
    if isinstance(corridor, MainAxis):
        return {"centre": corridor.centre, "direction": corridor.direction}
    return {"none": np.zeros(0)}


def corridor_from_arrays(arrays: CorridorArrays) -> Corridor:
    """Return the corridor of stored arrays."""
    if "trajectory" in arrays:
        time = arrays["time"] if len(arrays["time"]) else None
        return Trajectory(time, arrays["trajectory"], arrays["station"])
    if "centre" in arrays:
        return MainAxis(arrays["centre"], arrays["direction"])
    return None
