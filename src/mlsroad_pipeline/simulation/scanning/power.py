"""Automatic power: a laser is turned down while its returns are strong, and what that does to recorded intensity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.street.street import generator

_NONE = np.zeros(0, np.float32)


class Power(NamedTuple):
    """What became of the amplitude of each pulse's returns, decibels.

    Parameters
    ----------
    lowered : ndarray of shape (n,), float32
        How far the pulse was below full power; empty where the power is fixed.
    gain : ndarray of shape (n,), float32
        What its beam's calibration adds to the recorded intensity; empty where all beams are alike.
    """

    lowered: NDArray[np.float32]
    gain: NDArray[np.float32]


def power_of(
    device: Device, time: NDArray[np.float64], amplitude: NDArray[np.float32], *, seed: int, scanner: int
) -> Power:
    """Return the power of each pulse of a device, and the gain of its beam.

    Parameters
    ----------
    device : Device
        The device.
    time : ndarray of shape (n,), float64
        When each pulse left, seconds since the start, rising.
    amplitude : ndarray of shape (n,), float32
        What would come back of it at full power, decibels; below -90 where nothing does.
    seed : int
        The survey's seed: beams keep their gains through a survey.
    scanner : int
        Number of the device on the vehicle.

    Returns
    -------
    Power
        Of each pulse.
    """
    if device.power_control == 0 and device.gain_spread == 0:
        return Power(_NONE, _NONE)
    # Pulses are numbered from the start of the drive, and beams fire in turn.
    beam = np.floor(time * device.pulse_rate + 0.25).astype(np.int64) % len(device.elevations)
    lowered = gain = _NONE
    if device.power_control > 0:
        lowered = lowered_power(
            amplitude, beam, len(device.elevations), device.power_control, device.power_target, device.power_memory
        )
    if device.gain_spread > 0:
        gains = device.gain_spread * generator(seed, 23, scanner).standard_normal(len(device.elevations))
        gain = gains[beam].astype(np.float32)
    return Power(lowered, gain)


@njit(cache=True, nogil=True, error_model="numpy")
def lowered_power(
    amplitude: NDArray[np.float32], beam: NDArray[np.int64], beams: int, most: float, target: float, memory: int
) -> NDArray[np.float32]:
    """Return how far each pulse is below full power.

    A beam's level is the mean of its last answers, each at what it would be at full power, older ones counting less;
    the pulse is lowered by what that is above the target. Nothing is known of a beam before its first answer here, so
    that one counts for itself.

    Parameters
    ----------
    amplitude : ndarray of shape (n,), float32
        Answers in the order sent, decibels; below -90 where there is none.
    beam : ndarray of shape (n,), int64
        Number of each pulse's beam.
    beams : int
        Number of beams.
    most : float
        Most by which the power is lowered, decibels.
    target : float
        Level that is kept, decibels.
    memory : int
        Answers over which the level is averaged.

    Returns
    -------
    ndarray of shape (n,), float32
        Decibels, 0 to `most`.
    """
    level, count = np.zeros(beams), np.zeros(beams, np.int64)
    out = np.empty(len(amplitude), np.float32)
    for i in range(len(amplitude)):
        b = beam[i]
        answer = amplitude[i]
        if count[b] == 0 and answer > -90.0:
            level[b] = answer
        out[i] = min(max(level[b] - target, 0.0), most)
        if answer > -90.0:
            count[b] += 1
            level[b] += (answer - level[b]) / min(count[b], memory)
    return out
