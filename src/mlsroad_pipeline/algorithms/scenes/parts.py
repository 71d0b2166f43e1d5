"""Division of a drive into a training part and a test part that share no surroundings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.validation import check_positive

NEITHER, TRAIN, TEST = 0, 1, 2
"""Parts of a recording; neither: the gap between them."""


@dataclass(frozen=True)
class Pose:
    """Place of a scan in the frame of its drive."""

    # x, y: position of the scanner, metres
    x: float
    y: float
    heading: float  # Direction of the scanner's x axis, degrees counterclockwise

    def placed(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return points of the scan in the frame of the drive."""
        cosine, sine = np.cos(np.radians(self.heading)), np.sin(np.radians(self.heading))
        return xy @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([self.x, self.y])


@dataclass(frozen=True)
class HalfPlane:
    """Test part of a drive: the points beyond a vertical plane."""

    azimuth: float  # Direction of the plane's normal, degrees counterclockwise from the x axis of the drive
    # Distance of the plane from the origin of the drive along the normal, metres; the test part lies beyond
    offset: float

    def distance(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the signed distance of points from the plane, above zero in the test part."""
        turn = np.radians(self.azimuth)
        return xy @ np.array([np.cos(turn), np.sin(turn)]) - self.offset


def parts_beyond(distance: ArrayLike, gap: float) -> NDArray[np.uint8]:
    """Divide points by their distance from the plane before the test part."""
    check_positive(gap, "gap")
    values = np.asarray(distance)
    return np.where(values > gap / 2, TEST, np.where(values < -gap / 2, TRAIN, NEITHER)).astype(np.uint8)


def within_distance(xyz: NDArray[np.float64], others: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """Return which points lie within a distance of any other point."""
    inside = np.zeros(len(xyz), np.bool_)
    low, high = others.min(axis=0) - reach, others.max(axis=0) + reach
    rows = np.flatnonzero(((xyz >= low) & (xyz <= high)).all(axis=1))
    if len(rows):
        distance, _ = cKDTree(others).query(xyz[rows], distance_upper_bound=reach)
        inside[rows] = np.isfinite(distance)
    return inside
