"""Two rotating line scanners on the van: where their pulses go, and where returns lie by the reported trajectory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.drive import PLATFORM, RATE, Drive
from mlsroad_pipeline.algorithms.simulation.meshes import rotation_matrix
from mlsroad_pipeline.algorithms.simulation.presets import SimulationParameters

LEVER = np.array([[-0.25, 0.55, 0.8], [-0.25, -0.55, 0.8]])
"""Where the two scanners are on the van, metres from the frame's origin."""

MOUNTING = np.stack([rotation_matrix(yaw, np.radians(20.0), 0.0) for yaw in np.radians([45.0, -45.0])])
"""Axes of rotation: crossed at 45 degrees to the driving direction and tilted, so that no profile is upright."""

_BODY = np.array([[-0.05, 5.0], [-1.0, 1.0], [-PLATFORM, 0.0]])  # the van, in its own frame


class Pulses(NamedTuple):
    """Pulses of one scanner in the order sent.

    Parameters
    ----------
    time : ndarray of shape (n,), float64
        Seconds since the start.
    angle : ndarray of shape (n,), float64
        Angle of the mirror, radians; 0 is down.
    beam : ndarray of shape (n, 3), float32
        Direction in the van's frame.
    rays : ndarray of shape (n, 6), float32
        Origin relative to the scene's centre, and direction, both as they truly are.
    """

    time: NDArray[np.float64]
    angle: NDArray[np.float64]
    beam: NDArray[np.float32]
    rays: NDArray[np.float32]


def send_pulses(
    drive: Drive, parameters: SimulationParameters, *, scanner: int, first: int, last: int, centre: NDArray[np.float64]
) -> Pulses:
    """Return the pulses numbered first to last (exclusive) of one scanner.

    Parameters
    ----------
    drive : Drive
        Where the van is.
    parameters : SimulationParameters
        Pulse and profile rates.
    scanner : int
        0 or 1.
    first, last : int
        Numbers of pulses since the start.
    centre : ndarray of shape (3,)
        What ray origins are relative to, metres.

    Returns
    -------
    Pulses
        Those that do not hit the van itself.
    """
    # The second scanner is half a pulse and a third of a turn behind, as two devices are never in step.
    time = (np.arange(first, last) + 0.5 * scanner) / parameters.pulse_rate
    turns = time * parameters.profile_rate + scanner / 3.0
    angle = 2 * np.pi * (turns - np.floor(turns + 0.5))
    beam, rays, clear = _rays(time, angle, MOUNTING[scanner], LEVER[scanner], drive.true, centre, _BODY)
    return Pulses(time[clear], angle[clear], beam[clear], rays[clear])


def georeference(
    pulses: Pulses, rows: NDArray[np.int64], distance: NDArray[np.float64], drive: Drive, *, scanner: int
) -> NDArray[np.float64]:
    """Return where returns are by the reported trajectory, street-local metres.

    Parameters
    ----------
    pulses : Pulses
        All pulses.
    rows : ndarray of shape (m,), int64
        The pulse of each return.
    distance : ndarray of shape (m,), float64
        Its measured range, metres.
    drive : Drive
        The drive.
    scanner : int
        0 or 1.

    Returns
    -------
    ndarray of shape (m, 3), float64
        Coordinates.
    """
    return _georeference(pulses.time[rows], pulses.beam[rows], distance, LEVER[scanner], drive.reported)


@njit(cache=True, nogil=True)
def _pose(time: float, poses: NDArray[np.float64], position: NDArray[np.float64], turn: NDArray[np.float64]) -> None:
    """Write position and rotation matrix at a time, interpolated, into two buffers."""
    u = min(max(time * RATE, 0.0), len(poses) - 1.000001)
    k = int(u)
    f = u - k
    for r in range(3):
        position[r] = poses[k, r] + f * (poses[k + 1, r] - poses[k, r])
    roll, pitch = poses[k, 3] + f * (poses[k + 1, 3] - poses[k, 3]), poses[k, 4] + f * (poses[k + 1, 4] - poses[k, 4])
    yaw = poses[k, 5] + f * (poses[k + 1, 5] - poses[k, 5])
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    turn[0, 0], turn[0, 1], turn[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    turn[1, 0], turn[1, 1], turn[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    turn[2, 0], turn[2, 1], turn[2, 2] = -sp, cp * sr, cp * cr


@njit(cache=True, nogil=True)
def _rays(
    time: NDArray[np.float64], angle: NDArray[np.float64], mounting: NDArray[np.float64], lever: NDArray[np.float64],
    poses: NDArray[np.float64], centre: NDArray[np.float64], body: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:  # fmt: skip
    n = len(time)
    beam, rays, clear = np.empty((n, 3), np.float32), np.empty((n, 6), np.float32), np.ones(n, np.bool_)
    position, turn = np.empty(3), np.empty((3, 3))
    for i in range(n):
        _pose(time[i], poses, position, turn)
        side, down = np.sin(angle[i]), -np.cos(angle[i])
        inward, outward = 0.0, 1e9
        for r in range(3):
            direction = mounting[r, 1] * side + mounting[r, 2] * down
            beam[i, r] = direction
            pace = direction if abs(direction) > 1e-9 else 1e-9
            a, b = (body[r, 0] - lever[r]) / pace, (body[r, 1] - lever[r]) / pace
            inward, outward = max(inward, min(a, b)), min(outward, max(a, b))
        clear[i] = inward > outward
        for r in range(3):
            start = position[r] + turn[r, 0] * lever[0] + turn[r, 1] * lever[1] + turn[r, 2] * lever[2]
            rays[i, r] = start - centre[r]
            rays[i, 3 + r] = turn[r, 0] * beam[i, 0] + turn[r, 1] * beam[i, 1] + turn[r, 2] * beam[i, 2]
    return beam, rays, clear


@njit(cache=True, nogil=True)
def _georeference(
    time: NDArray[np.float64], beam: NDArray[np.float32], distance: NDArray[np.float64], lever: NDArray[np.float64],
    poses: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    xyz = np.empty((len(time), 3))
    position, turn = np.empty(3), np.empty((3, 3))
    for i in range(len(time)):
        _pose(time[i], poses, position, turn)
        for r in range(3):
            total = position[r]
            for c in range(3):
                total += turn[r, c] * (lever[c] + distance[i] * beam[i, c])
            xyz[i, r] = total
    return xyz
