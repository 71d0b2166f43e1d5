"""Automatic power control of a laser, and its effect on recorded intensity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.street.street import generator

_NONE = np.zeros(0, np.float32)


class Power(NamedTuple):
    """Power state of each pulse, decibels."""

    lowered: NDArray[np.float32]  # Reduction below full power; empty for a fixed power
    gain: NDArray[np.float32]  # Gain of the beam in the recorded intensity; empty if all beams are alike


def power_of(
    device: Device, time: NDArray[np.float64], amplitude: NDArray[np.float32], *, seed: int, scanner: int
) -> Power:
    """Return the power of each pulse of a device, and the gain of its beam.

    `time` rises, in seconds since the start; `amplitude` is that of the return at full power, decibels, below -90
    without one. Beams keep their gains throughout a survey, so they follow from `seed` and the number of the `scanner`.
    """
    if device.power_control == 0 and device.gain_spread == 0:
        return Power(_NONE, _NONE)
    # Pulses are numbered from the start of the drive, and beams fire cyclically.
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
    """Return the reduction of each pulse below full power, 0 to `most` decibels.

    The level of a beam is the running mean over `memory` of its returns, each at its amplitude at full power (below -90
    where there is none). The pulse is lowered by the excess of the level over the `target`.
    """
    level, count = np.zeros(beams), np.zeros(beams, np.int64)
    out = np.empty(len(amplitude), np.float32)
    for i in range(len(amplitude)):
        b = beam[i]
        received = amplitude[i]
        if count[b] == 0 and received > -90.0:
            level[b] = received
        out[i] = min(max(level[b] - target, 0.0), most)
        if received > -90.0:
            count[b] += 1
            level[b] += (received - level[b]) / min(count[b], memory)
    return out
