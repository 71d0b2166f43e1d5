"""Colours of leaves, blossoms and barks, drawn for each plant."""

from __future__ import annotations

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.meshes import BARK, FOLIAGE, Surface

# name: (linear rgb, near-infrared reflectivity). Needles hold more water and shade themselves: they reflect less.
_LEAVES: dict[str, tuple[tuple[float, float, float], float]] = {
    "green": ((0.085, 0.19, 0.04), 0.44),
    "dark": ((0.045, 0.115, 0.03), 0.40),
    "light": ((0.15, 0.27, 0.055), 0.48),
    "olive": ((0.13, 0.17, 0.085), 0.42),
    "blue": ((0.10, 0.16, 0.12), 0.36),
    "needle": ((0.045, 0.105, 0.045), 0.32),
    "copper": ((0.13, 0.05, 0.045), 0.42),
    "yellow": ((0.40, 0.27, 0.04), 0.46),
    "dry": ((0.33, 0.24, 0.125), 0.46),
    "straw": ((0.36, 0.31, 0.17), 0.46),
    "pink": ((0.62, 0.22, 0.33), 0.5),
    "white": ((0.70, 0.68, 0.62), 0.52),
    "purple": ((0.30, 0.14, 0.45), 0.48),
    "red": ((0.50, 0.05, 0.05), 0.46),
}
_BARKS: dict[str, tuple[tuple[float, float, float], float]] = {
    "brown": ((0.16, 0.12, 0.085), 0.34),
    "grey": ((0.24, 0.22, 0.19), 0.38),
    "pale": ((0.52, 0.50, 0.45), 0.48),
    "dark": ((0.085, 0.07, 0.06), 0.28),
    "reddish": ((0.25, 0.13, 0.08), 0.36),
    "palm": ((0.25, 0.20, 0.15), 0.38),
    "smooth_palm": ((0.36, 0.34, 0.30), 0.42),
    "stake": ((0.36, 0.26, 0.15), 0.46),
}


def _drawn(
    rgb: tuple[float, float, float], near: float, label: str, kind: int, rng: np.random.Generator, spread: float
) -> Surface:
    tone = float(np.exp(rng.normal(0.0, spread)))
    hue = 0.08 if kind == FOLIAGE else 0.035
    r, g, b = (float(c) for c in np.clip(np.array(rgb) * tone * np.exp(rng.normal(0, hue, 3)), 0.01, 0.92))
    reflectivity = near * tone**0.4 * float(np.exp(rng.normal(0, 0.5 * spread)))
    return Surface(TAXONOMY[label], (r, g, b), float(np.clip(reflectivity, 0.05, 0.9)), kind)


def foliage(name: str, label: str, rng: np.random.Generator) -> Surface:
    """Return the average leaf or petal of one plant, in a named colour such as ``"green"`` or ``"needle"``."""
    rgb, near = _LEAVES[name]
    return _drawn(rgb, near, label, FOLIAGE, rng, 0.2)


def bark(name: str, label: str, rng: np.random.Generator) -> Surface:
    """Return the bark of one plant, in a named colour such as ``"brown"`` or ``"palm"``."""
    rgb, near = _BARKS[name]
    return _drawn(rgb, near, label, BARK, rng, 0.22)


def same_as(surface: Surface, label: str) -> Surface:
    """Return the same material under another class."""
    return Surface(TAXONOMY[label], surface.rgb, surface.reflectivity, surface.kind)
