"""Corridor that a survey is cut along: its trajectory or the main axis of its points."""

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
    """Straight corridor, for surveys without a trajectory.

    Parameters
    ----------
    centre : ndarray of float64, shape (2,)
        Point on the axis, world coordinates, metres.
    direction : ndarray of float64, shape (2,)
        Unit vector along the axis.
    """

    centre: NDArray[np.float64]
    direction: NDArray[np.float64]

    def locate(
        self, xyz: ArrayLike, *, origin: ArrayLike = (0.0, 0.0, 0.0)
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return station and offset of points relative to the axis.

        Parameters
        ----------
        xyz : array-like of shape (n, 3)
            Coordinates, metres.
        origin : array-like of shape (3,), default zeros
            World coordinates of the origin of `xyz`.

        Returns
        -------
        station, offset : ndarray of float64, shape (n,)
            Metres along the axis from its centre, and metres to its right.

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
"""Corridor of a survey; without one (None) each file is one bin."""


def main_axis(xyz: ArrayLike) -> MainAxis:
    """Return the first principal axis of points in plan.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        World coordinates of a sample of the survey, metres; at least two points.

    Returns
    -------
    MainAxis
        Axis through the mean; it points east, or north if it has no eastward component.

    Raises
    ------
    DataError
        If there are fewer than two points, all points coincide in plan, or a coordinate is NaN or infinite.
    """
    points = check_xyz(xyz, minimum=2)[:, :2].astype(np.float64)
    centre = points.mean(axis=0)
    moved = points - centre
    values, vectors = np.linalg.eigh(moved.T @ moved / len(moved))
    if values[1] <= 0.0:
        raise DataError(f"{len(points)} points coincide in plan ({centre.tolist()}): they have no main axis")
    direction = vectors[:, 1]
    sign = 1.0 if (direction[0], direction[1]) > (0.0, 0.0) else -1.0
    return MainAxis(centre, direction * sign)
