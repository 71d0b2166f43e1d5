"""What a survey is cut along: its trajectory, the main axis of its points, or nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


@dataclass(frozen=True)
class MainAxis:
    """A straight corridor, for surveys without a trajectory.

    Parameters
    ----------
    centre : ndarray of float64, shape (2,)
        A point on the axis, world coordinates, metres.
    direction : ndarray of float64, shape (2,)
        Unit vector along the axis.
    """

    centre: NDArray[np.float64]
    direction: NDArray[np.float64]

    def locate(
        self, xyz: ArrayLike, *, origin: ArrayLike = (0.0, 0.0, 0.0)
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Find where points are along the axis.

        Parameters
        ----------
        xyz : array-like of shape (n, 3)
            Coordinates, metres.
        origin : array-like of shape (3,), default zeros
            World coordinates of the zero of `xyz`.

        Returns
        -------
        station, offset : ndarray of float64, shape (n,)
            Metres along the axis from its centre, and metres to the right of it.

        Raises
        ------
        DataError
            If `xyz` is not (n, 3) or has NaN or infinite coordinates.
        """
        points = check_xyz(xyz)
        shift = np.asarray(origin, dtype=np.float64)[:2] - self.centre
        x, y = points[:, 0] + shift[0], points[:, 1] + shift[1]
        ux, uy = self.direction
        return x * ux + y * uy, x * uy - y * ux


Corridor: TypeAlias = Trajectory | MainAxis | None
"""What a survey is cut along; None makes each file one bin."""


def main_axis(xyz: ArrayLike) -> MainAxis:
    """Find the direction in plan in which points extend most.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        World coordinates of a sample of the survey, metres; at least two points.

    Returns
    -------
    MainAxis
        Axis through the mean, first principal direction, pointing east (or north where it has no eastward part).

    Raises
    ------
    DataError
        If there are fewer than two points, all at one place in plan, or a coordinate is NaN or infinite.
    """
    points = check_xyz(xyz, minimum=2)[:, :2].astype(np.float64)
    centre = points.mean(axis=0)
    moved = points - centre
    values, vectors = np.linalg.eigh(moved.T @ moved / len(moved))
    if values[1] <= 0.0:
        raise DataError(f"{len(points)} points at one place in plan ({centre.tolist()}) have no main axis")
    direction = vectors[:, 1]
    sign = 1.0 if (direction[0], direction[1]) > (0.0, 0.0) else -1.0
    return MainAxis(centre, direction * sign)
