"""Drive of the van: true poses, those that its positioning system reports, and poses between them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.street.street import Street, generator

RATE = 200.0  # Poses per second
PAUSE = 120.0  # Seconds between two passes


@dataclass(frozen=True)
class Drive:
    """Poses of the van's frame: x forward, y left, z up, origin on the roof platform.

    A vector v of the van's frame is Rz(heading) Ry(pitch) Rx(roll) v in the world, angles right-handed in radians:
    heading is counter-clockwise from east, pitch is positive nose down, roll is positive left side up.
    """

    time: NDArray[np.float64]  # Seconds since the start, `RATE` per second
    station: NDArray[np.float64]  # Metres along the alignment
    # true, reported: x, y, z (street-local metres), roll, pitch, heading
    true: NDArray[np.float64]
    reported: NDArray[np.float64]
    start: float  # GPS seconds at time 0
    body: NDArray[np.float64]  # The vehicle in its own frame: from and to along x, y and z, metres

    @property
    def duration(self) -> float:
        """Seconds from the first to the last pose."""
        return float(self.time[-1])

    def time_at(self, station: float) -> float:
        """Return when the van passes a station; beyond the ends, extrapolated at the mean speed."""
        speed = (self.station[-1] - self.station[0]) / self.duration
        if station < self.station[0]:
            return float((station - self.station[0]) / speed)
        if station > self.station[-1]:
            return float(self.duration + (station - self.station[-1]) / speed)
        return float(np.interp(station, self.station, self.time))

    def table(self, parameters: SimulationParameters) -> pd.DataFrame:
        """Return the reported trajectory: gps_time, world x, y, z, roll, pitch, heading."""
        columns = dict(zip(("x", "y", "z", "roll", "pitch", "heading"), self.reported.T, strict=True))
        frame = pd.DataFrame({"gps_time": self.time + self.start, **columns})
        frame["x"] += parameters.easting
        frame["y"] += parameters.northing
        frame["z"] += parameters.height
        frame["heading"] = np.angle(np.exp(1j * frame["heading"]))
        return frame


def drifting(
    rng: np.random.Generator, time: NDArray[np.float64], *, deviation: float, slow: float, fast: float
) -> NDArray:
    """Return smooth noise over time, seconds: eight sinusoids with periods between `fast` and `slow` seconds.

    Its long-term standard deviation is `deviation`; slow sinusoids are stronger.
    """
    period = np.exp(rng.uniform(np.log(fast), np.log(slow), 8))
    weight = period**0.5
    phase = rng.uniform(0, 2 * np.pi, 8)
    total = np.zeros(len(time))
    for p, w, f in zip(period, weight, phase, strict=True):
        total += w * np.sin(2 * np.pi * time / p + f)
    return total * deviation * np.sqrt(2 / (weight**2).sum())


def drive_along(
    street: Street, parameters: SimulationParameters, *, length: float, number: int = 0, start: float | None = None
) -> Drive:
    """Drive along a street in the rightmost lane, from station 0 to `length`.

    Passes with a `number` above 0 have another track, and their reported positions a constant offset of `pass_offset`.
    `start` is in GPS seconds, that of the parameters by default.
    """
    rng = generator(street.seed, 20) if number == 0 else generator(street.seed, 20, number)
    phase = rng.uniform(0, 2 * np.pi, 2)
    steady = np.arange(0, 1.6 * length / parameters.speed + 2, 1 / RATE)
    factor = 1 + 0.1 * np.sin(2 * np.pi * steady / 23.0 + phase[0]) + 0.05 * np.sin(2 * np.pi * steady / 7.0 + phase[1])
    station = np.concatenate([[0.0], np.cumsum(parameters.speed * factor[:-1] / RATE)])
    count = int(np.searchsorted(station, length)) + 1
    time, station = steady[:count], station[:count]
    lanes = int(street.ground.shape[4])
    left = -street.ground.lane_centre(lanes - 1) + drifting(rng, time, deviation=0.12, slow=20, fast=5)
    xy, heading = street.alignment.place(station, left)
    z = street.ground.height(station, left)
    ahead, behind = (street.ground.height(station + d, left) for d in (1.4, -1.4))
    right, port = (street.ground.height(station, left + d) for d in (-0.8, 0.8))
    pitch = -np.arctan((ahead - behind) / 2.8) + drifting(rng, time, deviation=0.0018, slow=2.5, fast=0.6)
    roll = np.arctan((port - right) / 1.6) + drifting(rng, time, deviation=0.0022, slow=3.0, fast=0.7)
    yaw = heading + np.gradient(left, station)
    bounce = drifting(rng, time, deviation=0.006, slow=2.0, fast=0.5)
    true = np.column_stack([xy, z + parameters.scanner.platform + bounce, roll, pitch, yaw])
    errors = []
    for deviation in (0.008, 0.008, 0.012, 6e-5, 6e-5, 1.2e-4):
        drift = drifting(rng, time, deviation=deviation * parameters.trajectory_noise, slow=60, fast=4)
        jitter = drifting(rng, time, deviation=0.1 * deviation * parameters.trajectory_noise, slow=1.0, fast=0.2)
        errors.append(drift + jitter)
    reported = true + np.stack(errors, axis=1)
    if number > 0:
        towards = rng.standard_normal(3)
        reported[:, :3] += parameters.pass_offset * towards / np.linalg.norm(towards)
    begin = parameters.start_time if start is None else start
    return Drive(time, station, true, reported, begin, parameters.scanner.box)


def pose_at(poses: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Interpolate poses, (m, 6), `RATE` per second, at a time in seconds; beyond both ends the last one holds."""
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
