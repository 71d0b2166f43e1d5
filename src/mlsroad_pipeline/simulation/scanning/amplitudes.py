"""Amplitude of a return, its recorded intensity, and its range noise."""

from __future__ import annotations

import numpy as np

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import GLASS, GROUND, PAINT, RETRO
from mlsroad_pipeline.simulation.rays.surfaces import WET

FULL_SCALE_DB = 50.0
"""Amplitude of intensity 1, decibels above the unit of amplitude."""

SATURATION_DB = 44.0
"""Amplitude from which on a return saturates and blooms, decibels."""

_WHITE_DB = 38.0  # amplitude of a white surface at normal incidence, 10 m away
_NEPER = 0.23025850929940458  # ln(10) / 10
_ROUGHNESS = 0.6  # standard deviation of the micro-slopes of asphalt, gravel and soil, radians
_ROUGH_A = 1.0 - 0.5 * _ROUGHNESS**2 / (_ROUGHNESS**2 + 0.33)
_ROUGH_B = 0.45 * _ROUGHNESS**2 / (_ROUGHNESS**2 + 0.09)


@leaf
def deviation(range_noise: float, amplitude: float, stretch: float) -> float:
    """Return the standard deviation of a range; see `range_deviation`."""
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

    The qualitative model of Oren and Nayar (1994) with light and eye in one direction. A roughness of 0 is Lambert's
    law.
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
