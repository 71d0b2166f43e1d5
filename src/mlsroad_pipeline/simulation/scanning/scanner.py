"""Where the pulses of a scanner go, and where returns lie by the reported trajectory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix
from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.street.drive import RATE, Drive
from mlsroad_pipeline.simulation.street.street import generator

_ANEW = 64  # pulses after which the sine of the angle is computed anew


class Pulses(NamedTuple):
    """Pulses of one scanner in the order sent.

    Parameters
    ----------
    time : ndarray of shape (n,), float64
        Seconds since the start.
    angle : ndarray of shape (n,), float64
        Angle of the head, radians, -pi to pi.
    beam : ndarray of shape (n, 3), float32
        Direction in the vehicle's frame.
    rays : ndarray of shape (n, 6), float32
        Origin relative to the scene's centre, and direction, both as they truly are.
    """

    time: NDArray[np.float64]
    angle: NDArray[np.float64]
    beam: NDArray[np.float32]
    rays: NDArray[np.float32]


class Calibration(NamedTuple):
    """What the survey wrongly believes about a scanner.

    Parameters
    ----------
    turn : ndarray of shape (3, 3), float64
        Rotation from true to believed beam directions, in the vehicle's frame.
    shift : ndarray of shape (3,), float64
        Believed less true lever arm, metres.
    bias : float
        Measured less true range, metres.
    """

    turn: NDArray[np.float64]
    shift: NDArray[np.float64]
    bias: float


EXACT = Calibration(np.eye(3), np.zeros(3), 0.0)
"""A calibration without error."""


def draw_calibration(parameters: SimulationParameters, *, scanner: int) -> Calibration:
    """Draw the errors of a scanner's calibration; they stay the same through a survey.

    Parameters
    ----------
    parameters : SimulationParameters
        Seed, boresight error and the scanners.
    scanner : int
        Number of the scanner.

    Returns
    -------
    Calibration
        Its errors; none where `boresight_error` is 0 but the bias of the range.
    """
    rng = generator(parameters.seed, 22, scanner)
    turn = rotation_matrix(*(np.radians(parameters.boresight_error) * rng.standard_normal(3)))
    shift = parameters.boresight_error * rng.standard_normal(3)
    return Calibration(turn, shift, 0.5 * parameters.devices[scanner].accuracy * float(rng.standard_normal()))


def send_pulses(
    drive: Drive, device: Device, *, scanner: int = 0, first: int, last: int, centre: NDArray[np.float64]
) -> Pulses:
    """Return the pulses numbered first to last (exclusive) of one scanner.

    Parameters
    ----------
    drive : Drive
        Where the vehicle is.
    device : Device
        The scanner.
    scanner : int, default 0
        Its number; devices are never in step.
    first, last : int
        Numbers of pulses since the start.
    centre : ndarray of shape (3,)
        What ray origins are relative to, metres.

    Returns
    -------
    Pulses
        Those within the field of view that do not hit the vehicle itself.
    """
    # The next scanner is half a pulse and a third of a turn behind.
    phase = (0.5 * scanner, scanner / 3.0)
    elevations = np.radians(np.asarray(device.elevations))
    field = (np.radians(device.field[0]), np.radians(device.field[1]))
    time, angle, beam, rays = _rays(
        first, last, device.pulse_rate, device.profile_rate, phase, elevations, field, device.mounting,
        np.asarray(device.lever), drive.true, centre, drive.body,
    )  # fmt: skip
    return Pulses(time, angle, beam, rays)


def georeference(
    pulses: Pulses,
    rows: NDArray[np.int64],
    distance: NDArray[np.float64],
    drive: Drive,
    device: Device,
    *,
    calibration: Calibration = EXACT,
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
    device : Device
        The scanner.
    calibration : Calibration, default EXACT
        The errors of its calibration.

    Returns
    -------
    ndarray of shape (m, 3), float64
        Coordinates.
    """
    lever = np.asarray(device.lever) + calibration.shift
    return _georeference(
        pulses.time, pulses.beam, rows, distance, lever, calibration.turn, calibration.bias, drive.reported
    )


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
    """Write position and rotation at a time into two buffers and return the knot that `ends` holds the rotations of.

    Rotations are interpolated element by element: within 5 ms a vehicle turns so little that it changes no length by
    more than 1e-6.
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


@leaf
def _hits_body(
    beams: NDArray[np.float32], row: int, lever: NDArray[np.float64], body: NDArray[np.float64]
) -> bool:  # fmt: skip
    inward, outward = 0.0, 1e9
    for r in range(3):
        pace = beams[row, r] if abs(beams[row, r]) > 1e-9 else 1e-9
        a, b = (body[r, 0] - lever[r]) / pace, (body[r, 1] - lever[r]) / pace
        inward, outward = max(inward, min(a, b)), min(outward, max(a, b))
    return inward <= outward


@njit(cache=True, nogil=True, error_model="numpy")
def _rays(
    first: int, last: int, pulse_rate: float, profile_rate: float, phase: tuple[float, float],
    elevations: NDArray[np.float64], field: tuple[float, float], mounting: NDArray[np.float64],
    lever: NDArray[np.float64], poses: NDArray[np.float64], centre: NDArray[np.float64], body: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
    n = last - first
    times, angles = np.empty(n), np.empty(n)
    beams, rays = np.empty((n, 3), np.float32), np.empty((n, 6), np.float32)
    position, turn, ends = np.empty(3), np.empty((3, 3)), np.empty((2, 3, 3))
    n_beams = len(elevations)
    cosines, sines = np.cos(elevations), np.sin(elevations)
    step = 2 * np.pi * profile_rate / pulse_rate
    cosine, sine, turn_cosine, turn_sine = 1.0, 0.0, np.cos(step), np.sin(step)
    knot, m = -1, 0
    for i in range(first, last):
        time = (i + phase[0]) / pulse_rate
        turns = time * profile_rate + phase[1]
        angle = 2 * np.pi * (turns - np.floor(turns + 0.5))
        # Turned on from the pulse before, and set anew before rounding adds up.
        if (i - first) % _ANEW == 0:
            cosine, sine = np.cos(angle), np.sin(angle)
        else:
            cosine, sine = cosine * turn_cosine - sine * turn_sine, sine * turn_cosine + cosine * turn_sine
        if angle < field[0] or angle > field[1]:
            continue
        flat, lift = cosines[i % n_beams], sines[i % n_beams]
        side, down = flat * sine, -flat * cosine
        for r in range(3):
            beams[m, r] = mounting[r, 0] * lift + mounting[r, 1] * side + mounting[r, 2] * down
        if _hits_body(beams, m, lever, body):
            continue
        knot = pose_between(time, poses, knot, ends, position, turn)
        for r in range(3):
            start = position[r] + turn[r, 0] * lever[0] + turn[r, 1] * lever[1] + turn[r, 2] * lever[2]
            rays[m, r] = start - centre[r]
            rays[m, 3 + r] = turn[r, 0] * beams[m, 0] + turn[r, 1] * beams[m, 1] + turn[r, 2] * beams[m, 2]
        times[m], angles[m] = time, angle
        m += 1
    return times[:m], angles[:m], beams[:m], rays[:m]


@njit(cache=True, nogil=True, error_model="numpy")
def _georeference(
    time: NDArray[np.float64], beam: NDArray[np.float32], rows: NDArray[np.int64], distance: NDArray[np.float64],
    lever: NDArray[np.float64], boresight: NDArray[np.float64], bias: float, poses: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    xyz = np.empty((len(rows), 3))
    position, turn, ends, local = np.empty(3), np.empty((3, 3)), np.empty((2, 3, 3)), np.empty(3)
    knot = -1
    for i in range(len(rows)):
        j = rows[i]
        knot = pose_between(time[j], poses, knot, ends, position, turn)
        r = distance[i] + bias
        for a in range(3):
            along = boresight[a, 0] * beam[j, 0] + boresight[a, 1] * beam[j, 1] + boresight[a, 2] * beam[j, 2]
            local[a] = lever[a] + r * along
        for a in range(3):
            xyz[i, a] = position[a] + turn[a, 0] * local[0] + turn[a, 1] * local[1] + turn[a, 2] * local[2]
    return xyz
