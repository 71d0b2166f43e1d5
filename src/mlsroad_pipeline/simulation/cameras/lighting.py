"""Sun and sky, and the light reflected by surfaces."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.materials import value_noise
from mlsroad_pipeline.simulation.model.meshes import FOLIAGE, GLASS, PAINT
from mlsroad_pipeline.simulation.rays.surfaces import WET, Surfaces
from mlsroad_pipeline.simulation.street.street import generator


class Light(NamedTuple):
    """Sun, sky and exposure of a survey."""

    sun: NDArray[np.float64]  # Unit vector towards the sun
    # sun_rgb, sky_rgb: irradiance from the sun and from the sky
    sun_rgb: NDArray[np.float64]
    sky_rgb: NDArray[np.float64]
    haze: float  # Share of light lost per metre


def draw_light(seed: int) -> Light:
    """Return the light of a survey; time of day and weather follow from the seed. The sun is 25 to 65 degrees high."""
    rng = generator(seed, 40)
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(25, 65))
    sun = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    strength, sky = rng.uniform(0.6, 2.4), rng.uniform(0.75, 1.1)
    return Light(
        sun, strength * np.array([1.0, 0.94, 0.84]), sky * np.array([0.72, 0.82, 1.0]), rng.uniform(0.0002, 0.0018)
    )


# sRGB values of radiances 0 to 4 in steps of 1/2048: a soft shoulder instead of clipping.
_EXPOSED = 1.0 - np.exp(-1.25 * (np.arange(8192) + 0.5) / 2048.0)
_SRGB = np.where(_EXPOSED < 0.0031308, 12.92 * _EXPOSED, 1.055 * _EXPOSED ** (1 / 2.4) - 0.055)
_CURVE = (255.0 * _SRGB + 0.5).astype(np.uint8)


def in_the_sun(
    surfaces: Surfaces, normal: NDArray[np.float32], rays: NDArray[np.float32], distance: NDArray[np.float32],
    light: Light,
) -> NDArray[np.uint8]:  # fmt: skip
    """Return the colours of the hits of rays without cast shadows and noise: sRGB values, shape (n, 3)."""
    lit = np.ones(len(distance), np.bool_)
    light_at = radiance(surfaces, normal, rays, distance, lit, light)
    return expose(light_at, np.ones(len(lit), np.float32), np.zeros_like(light_at))


@njit(cache=True, nogil=True)
def expose(
    light_at: NDArray[np.float32], exposure: NDArray[np.float32], grain: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """Return the sRGB values of a sensor for linear radiance: shot and read noise, a soft shoulder.

    `exposure` is a factor (gain and vignetting), `grain` standard normal numbers for the noise.
    """
    out = np.empty(light_at.shape, dtype=np.uint8)
    for i in range(len(light_at)):
        for c in range(3):
            value = light_at[i, c] * exposure[i]
            value = max(value + grain[i, c] * (0.003 + 0.012 * np.sqrt(value)), 0.0)
            out[i, c] = _CURVE[min(int(value * 2048.0), len(_CURVE) - 1)]
    return out


@njit(cache=True, nogil=True)
def _clouds(dx: float, dy: float, dz: float) -> float:
    """Return the cloud cover in a direction of the sky, 0 to 1."""
    if dz < 0.02:
        return 0.0
    x, y = dx / (dz + 0.15), dy / (dz + 0.15)
    cover = 0.6 * value_noise(x * 1.3, y * 1.3, 3.5) + 0.4 * value_noise(x * 4.1, y * 4.1, 8.5)
    return min(max((cover - 0.5) * 4.0, 0.0), 1.0)


@njit(cache=True, nogil=True)
def radiance(
    surfaces: Surfaces, normal: NDArray[np.float32], rays: NDArray[np.float32], distance: NDArray[np.float32],
    lit: NDArray[np.bool_], light: Light,
) -> NDArray[np.float32]:  # fmt: skip
    """Return the linear radiance along rays, shape (n, 3): about 1 for a white wall in the sun, else of the sky.

    `distance` is infinite in the sky (haze grows with it), `lit` whether the sun reaches the place.
    """
    sun, sun_rgb, sky_rgb, haze = light
    out = np.empty((len(lit), 3), dtype=np.float32)
    for i in range(len(lit)):
        dx, dy, dz = rays[i, 3], rays[i, 4], rays[i, 5]
        sky = 0.55 + 0.45 * (1.0 - max(dz, 0.0)) ** 3
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        if nx * dx + ny * dy + nz * dz > 0:
            nx, ny, nz = -nx, -ny, -nz
        direct = max(nx * sun[0] + ny * sun[1] + nz * sun[2], 0.0) if lit[i] else 0.0
        kind = surfaces.kind[i]
        if kind == FOLIAGE:  # leaves are translucent
            direct = 0.35 + 0.65 * direct if lit[i] else 0.0
        seen = np.isfinite(distance[i])
        fade = np.exp(-haze * distance[i]) if seen else 0.0
        cloud = 0.0 if seen else _clouds(dx, dy, dz)
        gloss = 0.25 if kind == GLASS else 0.06 if kind == PAINT else 0.0
        if kind == WET:
            gloss = 0.04 + 0.5 * (1.0 - min(abs(nx * dx + ny * dy + nz * dz), 1.0)) ** 3
        for c in range(3):
            behind = sky * sky_rgb[c] * (1 - cloud) + cloud * 0.95
            value = surfaces.rgb[i, c] * (direct * sun_rgb[c] + (0.45 + 0.35 * nz) * sky_rgb[c])
            out[i, c] = fade * ((1 - gloss) * value + gloss * sky_rgb[c]) + (1 - fade) * behind
    return out
