"""Time-stamped poses of a vehicle and their interpolation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Poses of a vehicle over time. Build it with `from_angles` or `from_quaternions`."""

    time: NDArray[np.float64]  # Seconds, strictly increasing
    xyz: NDArray[np.float64]  # Positions, world coordinates, metres
    rotation: Rotation  # m rotations from the axes of the vehicle (x forward, y left, z up) to those of the world
    max_gap: float = 1.0  # Longest interval between two poses that is interpolated, seconds
    source: str = field(default="poses")  # Name of the poses in messages, usually the path of the file

    @classmethod
    def from_angles(
        cls, time: ArrayLike, xyz: ArrayLike, angles: ArrayLike, *, max_gap: float = 1.0, source: str = "poses"
    ) -> PoseTrack:
        """Build a track from roll, pitch and heading."""
        radians = check_xyz(angles, name=f"{source}: angles").astype(np.float64)
        return cls._build(time, xyz, Rotation.from_euler("xyz", radians), max_gap, source)

    @classmethod
    def from_quaternions(
        cls, time: ArrayLike, xyz: ArrayLike, quaternions: ArrayLike, *, max_gap: float = 1.0, source: str = "poses"
    ) -> PoseTrack:
        """Build a track from quaternions."""
        return cls._build(time, xyz, rotation_of(quaternions, source=source), max_gap, source)

    @classmethod
    def _build(cls, time: ArrayLike, xyz: ArrayLike, rotation: Rotation, max_gap: float, source: str) -> PoseTrack:
        places = check_xyz(xyz, name=f"{source}: positions").astype(np.float64)
        seconds = check_column(time, len(places), f"{source}: time").astype(np.float64)
        if len(rotation) != len(places):
            raise DataError(f"{source}: {len(places)} positions but {len(rotation)} rotations")
        if not np.isfinite(seconds).all():
            row = int(np.flatnonzero(~np.isfinite(seconds))[0])
            raise DataError(f"{source}: time at row {row} is {seconds[row]}")
        seconds, first = np.unique(seconds, return_index=True)
        if len(seconds) < 2:
            raise DataError(f"{source}: needs poses at two times at least, got {len(seconds)}")
        return cls(seconds, places[first], rotation[first], check_positive(max_gap, "max_gap"), source)

    def at(self, time: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Interpolate poses: positions linearly, rotations by slerp."""
        when = np.atleast_1d(np.asarray(time, dtype=np.float64))
        outside = ~((when >= self.time[0]) & (when <= self.time[-1]))
        if outside.any():
            raise DataError(
                f"{self.source}: {int(outside.sum())} of {len(when)} times lie outside the poses, which cover "
                f"{self.time[0]:.3f} to {self.time[-1]:.3f} s; the first is {when[outside][0]:.3f} s"
            )
        after = np.clip(np.searchsorted(self.time, when), 1, len(self.time) - 1)
        wide = (self.time[after] - self.time[after - 1] > self.max_gap) & ~np.isin(when, self.time)
        if wide.any():
            k = int(after[wide][0])
            raise DataError(
                f"{self.source}: no poses between {self.time[k - 1]:.3f} and {self.time[k]:.3f} s, a gap longer than "
                f"{self.max_gap:g} s, in which {int(wide.sum())} of {len(when)} times lie"
            )
        places = np.column_stack([np.interp(when, self.time, self.xyz[:, axis]) for axis in range(3)])
        return Slerp(self.time, self.rotation)(when).as_matrix(), places


def rotation_of(quaternions: ArrayLike, *, source: str = "poses") -> Rotation:
    """Return the rotations of quaternions w, x, y, z."""
    values = np.asarray(quaternions, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != 4:
        raise DataError(f"{source}: quaternions must have shape (m, 4), got {values.shape}")
    bad = ~(np.isfinite(values).all(axis=1) & (np.abs(values) > 0).any(axis=1))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise DataError(f"{source}: quaternion at row {row} is {values[row].tolist()}, no rotation")
    return Rotation.from_quat(values, scalar_first=True)
