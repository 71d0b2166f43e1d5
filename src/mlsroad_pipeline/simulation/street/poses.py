"""Poses of the vehicle between those of a drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.street.drive import RATE


def pose_at(poses: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Interpolate poses of shape (m, 6) linearly at a time in seconds; beyond both ends the last pose holds.

    There are `RATE` poses per second, at least two in all; their angles are continuous.
    """
    u = min(max(time * RATE, 0.0), len(poses) - 1.000001)
    k = int(u)
    row: NDArray[np.float64] = poses[k] + (u - k) * (poses[k + 1] - poses[k])
    return row


@leaf
def pose_matrix(roll: float, pitch: float, yaw: float, turn: NDArray[np.float64]) -> None:
    """Write the rotation Rz(yaw) Ry(pitch) Rx(roll) into a buffer."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    turn[0, 0], turn[0, 1], turn[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    turn[1, 0], turn[1, 1], turn[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    turn[2, 0], turn[2, 1], turn[2, 2] = -sp, cp * sr, cp * cr


@leaf
def pose_between(
    time: float, poses: NDArray[np.float64], knot: int, ends: NDArray[np.float64],
    position: NDArray[np.float64], turn: NDArray[np.float64],
) -> int:  # fmt: skip
    """Write position and rotation at a time into two buffers and return the knot whose rotations `ends` holds.

    Rotations are interpolated element by element: a vehicle turns so little within 5 ms that no length changes by more
    than 1e-6.
    """
    u = min(max(time * RATE, 0.0), len(poses) - 1.000001)
    k = int(u)
    f = u - k
    if k != knot:
        pose_matrix(poses[k, 3], poses[k, 4], poses[k, 5], ends[0])
        pose_matrix(poses[k + 1, 3], poses[k + 1, 4], poses[k + 1, 5], ends[1])
    for r in range(3):
        position[r] = poses[k, r] + f * (poses[k + 1, r] - poses[k, r])
        for c in range(3):
            turn[r, c] = ends[0, r, c] + f * (ends[1, r, c] - ends[0, r, c])
    return k
