"""Amplitude of a return, its recorded intensity, its range noise, and a laser's automatic power control."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import GLASS, GROUND, PAINT, RETRO
from mlsroad_pipeline.simulation.parameters.devices import Device
from mlsroad_pipeline.simulation.rays.surfaces import WET
from mlsroad_pipeline.simulation.street.street import generator

FULL_SCALE_DB = 50.0  # Amplitude of intensity 1, decibels above the unit of amplitude
SATURATION_DB = 44.0  # Amplitude from which on a return saturates and blooms, decibels
_WHITE_DB = 38.0  # amplitude of a white surface at normal incidence, 10 m away
_NEPER = 0.23025850929940458  # ln(10) / 10
_ROUGHNESS = 0.6  # standard deviation of the micro-slopes of asphalt, gravel and soil, radians
_ROUGH_A = 1.0 - 0.5 * _ROUGHNESS**2 / (_ROUGHNESS**2 + 0.33)
_ROUGH_B = 0.45 * _ROUGHNESS**2 / (_ROUGHNESS**2 + 0.09)


@leaf
def range_deviation(range_noise: float, amplitude: float, stretch: float) -> float:
    """Return the standard deviation of a range, metres, for an amplitude in decibels: weak returns are noisier."""
    return np.sqrt(range_noise * range_noise * (1.0 + np.exp(_NEPER * (14.0 - amplitude))) + stretch * stretch)


@leaf
def amplitude_of(reflectivity: float, kind: int, cosine: float, distance: float) -> float:
    """Return the amplitude of a return in decibels, by inverse square law, Lambert's law and gloss."""
    # Within some metres the spot is larger than the receiver's field of view.
    spread = (distance * distance + 16.0) / 100.0
    seen = backscatter(cosine) if kind == GROUND else max(cosine, 0.02)
    decibels = _WHITE_DB + 10 * np.log10(max(reflectivity * seen, 1e-6) / spread)
    if kind == WET:
        return decibels + _gloss(cosine, 6.0, 8.0) - 20.0 * (1.0 - cosine) ** 2
    if kind == RETRO:
        return decibels + _gloss(cosine, 35.0, 17.0)
    if kind == PAINT:
        return decibels + _gloss(cosine, 9.0, 9.0) - 2.0
    if kind == GLASS:
        return decibels + _gloss(cosine, 4.0, 10.0) - 14.0
    return decibels


@leaf
def backscatter(cosine: float) -> float:
    """Return the backscatter of rough ground over that of a smooth white surface at normal incidence.

    It is the qualitative model of Oren and Nayar (1994) with light and eye in one direction.
    """
    return _ROUGH_A * cosine + _ROUGH_B * (1.0 - cosine * cosine)


@leaf
def _gloss(cosine: float, width: float, height: float) -> float:
    """Return the gain of a lobe about the normal, decibels; its width is in degrees."""
    slant = np.degrees(np.arccos(min(cosine, 1.0))) / width
    return height * np.exp(-slant * slant)


@leaf
def mirrored_share(cosine: float) -> float:
    """Return the share of light that a pane or a film of water reflects like a mirror (Schlick's approximation)."""
    return 0.06 + 0.94 * (1.0 - cosine) ** 5


@leaf
def intensity_of(amplitude: float, distance: float, corrected: bool) -> float:
    """Return the recorded intensity, 0 to 1, of a return: its reflectance, or its amplitude with a soft limit."""
    if corrected:
        white = _WHITE_DB - 20 * np.log10(np.sqrt(distance * distance + 16.0) / 10.0)
        return min(10.0 ** ((amplitude - white) / 10.0), 1.0)
    if amplitude > SATURATION_DB:
        amplitude = SATURATION_DB + 6.0 * np.tanh((amplitude - SATURATION_DB) / 6.0)
    return min(max(amplitude / FULL_SCALE_DB, 0.0), 1.0)


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
