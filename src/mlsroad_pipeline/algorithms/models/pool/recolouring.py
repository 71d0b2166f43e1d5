"""Colours of the ground of simulated streets, varied as places, lights and cameras vary."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY

NATURAL = [TAXONOMY[name] for name in ("grass", "soil", "trail")]
GAMMA = 2.2
WEIGHTS = np.array([0.3, 0.6, 0.1])  # of the channels in the luminance
BRICK = np.array([0.35, 0.0, -0.4])  # logarithms of the channels of reddish paving against grey
BLUE = np.array([-0.5, 0.0, 0.6])  # the same of light from the sky alone
STRAW = np.array([0.36, 0.29, 0.15])  # linear colour of dry grass


def recoloured(
    xyz: NDArray[np.floating], rgb: NDArray[np.uint8], code: NDArray[np.integer], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return other colours of points; black points, which no camera saw, stay black and others do not become so."""
    light = (rgb / 255.0) ** GAMMA
    seen: NDArray[np.bool_] = np.asarray(rgb.any(axis=1))
    if rng.random() < 0.4:  # camera and scanner are not aligned
        _, other = cKDTree(xyz).query(xyz + np.append(rng.normal(0, 0.12, 2), 0))
        light, seen = light[other], seen[other]
    for one in np.unique(code):
        own = code == one
        vary = _natural if one in NATURAL else _paved
        light[own] = vary(light[own], xyz[own, :2], rng, road=one == TAXONOMY["road"])
    if rng.random() < 0.6:  # shade of trees and houses
        shaded = smooth_noise(xyz[:, :2], rng, rng.uniform(3, 15)) > rng.uniform(-0.3, 1.2)
        light[shaded] *= rng.uniform(0.12, 0.5) * np.exp(rng.uniform(0, 0.5) * BLUE)
    if rng.random() < 0.25:  # the cameras see one side
        angle = rng.uniform(0, 2 * np.pi)
        across = (xyz[:, :2] - xyz[:, :2].mean(axis=0)) @ [np.cos(angle), np.sin(angle)]
        seen = seen & (across <= rng.uniform(-10, 10))
    return np.where(seen[:, None], _photographed(light, rng), 0).astype(np.uint8)


def _paved(light: NDArray, xy: NDArray, rng: np.random.Generator, *, road: bool) -> NDArray:
    """Return paving of another tone and hue; other paving than roads is reddish or ochre in a third of the streets."""
    light = light * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.08, 3))
    return light if road or rng.random() > 0.3 else light * np.exp(rng.uniform(0.3, 1) * BRICK)


def _natural(light: NDArray, xy: NDArray, rng: np.random.Generator, *, road: bool) -> NDArray:
    """Return grass or soil that is dry in places."""
    straw = STRAW * np.exp(rng.normal(0, 0.12, 3))
    dry = np.clip(rng.uniform(-0.4, 0.7) + 0.35 * smooth_noise(xy, rng, rng.uniform(2, 15)), 0, 0.95)[:, None]
    withered = (light @ WEIGHTS)[:, None] * (straw / (straw @ WEIGHTS)) * rng.uniform(0.8, 1.6)
    return ((1 - dry) * light + dry * withered) * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.06, 3))


def _photographed(light: NDArray, rng: np.random.Generator) -> NDArray:
    """Return the values, 1 to 255, of a camera: exposure, white balance, saturation, tone curve and noise."""
    light = light * np.exp(rng.normal(-0.1, 0.35)) * np.exp(rng.normal(0, 0.1, 3))
    grey = light.mean(axis=1, keepdims=True)
    light = np.clip(grey + (light - grey) * rng.uniform(0.35, 1.4), 0, 1)
    values = 255 * light ** (1 / rng.uniform(1.6, 2.6))
    values = values * np.exp(rng.normal(0, rng.uniform(0, 0.05), light.shape))
    return np.clip(np.rint(values + rng.normal(0, rng.uniform(0, 4), light.shape)), 1, 255)


def smooth_noise(xy: NDArray[np.floating], rng: np.random.Generator, scale: float) -> NDArray[np.float64]:
    """Return noise of unit variance that changes within some `scale` metres."""
    waves = rng.normal(0, np.pi / scale, (6, 2))
    return np.cos(xy.astype(np.float64) @ waves.T + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1) / np.sqrt(3)
