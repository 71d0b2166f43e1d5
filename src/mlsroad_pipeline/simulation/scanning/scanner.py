"""Pulses of a scanner, and georeferencing of returns by the reported trajectory."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix
from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.street.drive import Drive, pose_between
from mlsroad_pipeline.simulation.street.street import generator

_ANEW = 64  # pulses after which sine and cosine of the angle are recomputed


class Pulses(NamedTuple):
    """Pulses of one scanner in the order sent."""

    time: NDArray[np.float64]  # Seconds since the start
    angle: NDArray[np.float64]  # Angle of the head, radians, -pi to pi
    beam: NDArray[np.float32]  # Direction in the vehicle's frame
    rays: NDArray[np.float32]  # True origin relative to the scene's centre, and true direction


class Calibration(NamedTuple):
    """Errors of a scanner's calibration."""

    turn: NDArray[np.float64]  # Rotation from true to calibrated beam directions, in the vehicle's frame
    shift: NDArray[np.float64]  # Calibrated minus true lever arm, metres
    bias: float  # Measured minus true range, metres


EXACT = Calibration(np.eye(3), np.zeros(3), 0.0)  # A calibration without error


def draw_calibration(parameters: SimulationParameters, *, scanner: int) -> Calibration:
    """Draw the calibration errors of a scanner, constant throughout a survey; the bias of ranges has its own size."""
    rng = generator(parameters.seed, 22, scanner)
    turn = rotation_matrix(*(np.radians(parameters.boresight_error) * rng.standard_normal(3)))
    shift = parameters.boresight_error * rng.standard_normal(3)
    return Calibration(turn, shift, 0.5 * parameters.devices[scanner].accuracy * float(rng.standard_normal()))


def send_pulses(
    drive: Drive, device: Device, *, scanner: int = 0, first: int, last: int, centre: NDArray[np.float64]
) -> Pulses:
    """Return the pulses first to last (exclusive) in view that miss the vehicle, with origins from `centre`."""
    # Scanners are out of phase, each by half a pulse and a third of a revolution.
    phase = (0.5 * scanner, scanner / 3.0)
    elevations = np.radians(np.asarray(device.elevations))
    field = (np.radians(device.field[0]), np.radians(device.field[1]))
    time, angle, beam, rays = _rays(
        first, last, device.pulse_rate, device.profile_rate, phase, elevations, field, device.mounting,
        np.asarray(device.lever), drive.true, centre, drive.body,
    )  # fmt: skip
    return Pulses(time, angle, beam, rays)


def georeference(
    pulses: Pulses, rows: NDArray[np.int64], distance: NDArray[np.float64], drive: Drive, device: Device, *,
    calibration: Calibration = EXACT,
) -> NDArray[np.float64]:  # fmt: skip
    """Return the coordinates of returns by the reported trajectory, street-local metres, shape (m, 3).

    `rows` are the pulses of the returns, `distance` their measured ranges in metres.
    """
    lever = np.asarray(device.lever) + calibration.shift
    return _georeference(pulses.time, pulses.beam, rows, distance, lever, calibration, drive.reported)


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
        # Rotated from the previous pulse, and recomputed before rounding errors accumulate.
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
    lever: NDArray[np.float64], calibration: Calibration, poses: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    boresight, _, bias = calibration
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
