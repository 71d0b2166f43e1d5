"""Materials, leaves and barks: albedo in the visible and at the scanner's wavelength, drawn for each object."""

from typing import NamedTuple

import numpy as np
from numba import njit

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.meshes import BARK, BRICK, DIFFUSE, FOLIAGE, GLASS, PAINT, RETRO, Surface

Colour = tuple[float, float, float]

# name: (linear rgb, reflectivity near 1550 nm, spread of tone, kind); reflectivities after common tables of targets.
_MATERIALS: dict[str, tuple[Colour, float, float, int]] = {
    "concrete": ((0.42, 0.40, 0.37), 0.38, 0.15, DIFFUSE),
    "plaster": ((0.62, 0.55, 0.44), 0.45, 0.25, DIFFUSE),
    "brick": ((0.36, 0.15, 0.10), 0.32, 0.25, BRICK),
    "stone": ((0.36, 0.33, 0.28), 0.33, 0.2, DIFFUSE),
    "roof_tile": ((0.30, 0.11, 0.07), 0.28, 0.25, BRICK),
    "room": ((0.10, 0.09, 0.08), 0.35, 0.4, DIFFUSE),
    "curtain": ((0.55, 0.52, 0.48), 0.5, 0.25, DIFFUSE),
    "galvanised": ((0.40, 0.41, 0.42), 0.35, 0.2, DIFFUSE),
    "painted_metal": ((0.14, 0.16, 0.15), 0.25, 0.45, DIFFUSE),
    "aluminium": ((0.55, 0.56, 0.57), 0.45, 0.15, DIFFUSE),
    "sign_back": ((0.38, 0.38, 0.39), 0.4, 0.2, DIFFUSE),
    "wood": ((0.25, 0.17, 0.10), 0.4, 0.3, BARK),
    "bark": ((0.16, 0.12, 0.085), 0.34, 0.3, BARK),
    "palm_bark": ((0.25, 0.20, 0.15), 0.38, 0.25, BARK),
    "leaf": ((0.09, 0.20, 0.045), 0.42, 0.25, FOLIAGE),
    "dry_leaf": ((0.35, 0.25, 0.12), 0.45, 0.2, FOLIAGE),
    "rubber": ((0.02, 0.02, 0.022), 0.06, 0.25, DIFFUSE),
    "plastic": ((0.10, 0.18, 0.13), 0.3, 0.5, DIFFUSE),
    "glass": ((0.10, 0.13, 0.15), 0.35, 0.2, GLASS),
    "wire": ((0.03, 0.03, 0.03), 0.22, 0.3, DIFFUSE),
    "skin": ((0.45, 0.28, 0.20), 0.4, 0.35, DIFFUSE),
    "seat": ((0.08, 0.08, 0.09), 0.3, 0.5, DIFFUSE),
}

# Colours of cars and their shares: three quarters are white, grey, silver or black.
_PAINTS: tuple[Colour, ...] = (
    (0.75, 0.75, 0.74), (0.18, 0.19, 0.2), (0.45, 0.46, 0.47), (0.03, 0.03, 0.035),
    (0.42, 0.03, 0.03), (0.04, 0.08, 0.28), (0.05, 0.16, 0.08), (0.5, 0.45, 0.33), (0.6, 0.33, 0.03), (0.2, 0.32, 0.42),
)  # fmt: skip
_PAINT_SHARES = np.cumsum([0.26, 0.19, 0.12, 0.19, 0.06, 0.08, 0.025, 0.025, 0.015, 0.035])

# name: (linear rgb, near-infrared reflectivity). Needles hold more water and shade themselves: they reflect less.
_LEAVES: dict[str, tuple[Colour, float]] = {
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
_BARKS: dict[str, tuple[Colour, float]] = {
    "brown": ((0.16, 0.12, 0.085), 0.34),
    "grey": ((0.24, 0.22, 0.19), 0.38),
    "pale": ((0.52, 0.50, 0.45), 0.48),
    "dark": ((0.085, 0.07, 0.06), 0.28),
    "reddish": ((0.25, 0.13, 0.08), 0.36),
    "palm": ((0.25, 0.20, 0.15), 0.38),
    "smooth_palm": ((0.36, 0.34, 0.30), 0.42),
    "stake": ((0.36, 0.26, 0.15), 0.46),
}


class _Sheeting(NamedTuple):
    red: Colour = (0.55, 0.03, 0.04)
    white: Colour = (0.8, 0.8, 0.8)
    blue: Colour = (0.03, 0.12, 0.5)
    yellow: Colour = (0.75, 0.5, 0.03)
    green: Colour = (0.02, 0.28, 0.13)


SIGN = _Sheeting()  # Linear albedo of new sign sheeting


def material(name: str, label: str, rng: np.random.Generator) -> Surface:
    """Return a surface of a named material of the table; its tone, hue and reflectivity are drawn."""
    rgb, reflectivity, spread, kind = _MATERIALS[name]
    return _drawn(rgb, reflectivity, TAXONOMY[label], kind, rng, (spread, 0.35 * spread, 0.6 * spread), (0.02, 0.95))


def _drawn(
    rgb: Colour, reflectivity: float, label: int, kind: int, rng: np.random.Generator,
    spreads: tuple[float, float, float], bounds: tuple[float, float],
) -> Surface:  # fmt: skip
    """Return a surface; `spreads` are those of tone, hue and reflectivity, `bounds` of the latter."""
    tone = float(np.exp(rng.normal(0.0, spreads[0])))
    r, g, b = (float(c) for c in np.clip(np.array(rgb) * tone * np.exp(rng.normal(0.0, spreads[1], 3)), 0.01, 0.92))
    # Tones in the near infrared and in the visible are loosely correlated.
    near_infrared = reflectivity * tone**0.4 * np.exp(rng.normal(0.0, spreads[2]))
    return Surface(label, (r, g, b), float(np.clip(near_infrared, *bounds)), kind)


def car_paint(label: str, rng: np.random.Generator) -> Surface:
    """Return a body paint: a common colour of cars in its own shade; dark paints reflect little."""
    row = int(np.searchsorted(_PAINT_SHARES, rng.random() * _PAINT_SHARES[-1], side="right"))
    tone = np.exp(rng.normal(0, 0.17)) * np.exp(rng.normal(0, 0.05, 3))
    r, g, b = (float(c) for c in np.clip(np.array(_PAINTS[row]) * tone + 0.005, 0.01, 0.9))
    reflectivity = 0.08 + 0.6 * (r + g + b) / 3 * float(np.exp(rng.normal(0, 0.3)))
    return Surface(TAXONOMY[label], (r, g, b), float(np.clip(reflectivity, 0.03, 0.85)), PAINT)


def cloth(label: str, rng: np.random.Generator) -> Surface:
    """Return clothing of any colour."""
    r, g, b = (float(c) for c in rng.uniform(0.03, 0.55, 3) * rng.uniform(0.3, 1.0))
    return Surface(TAXONOMY[label], (r, g, b), float(rng.uniform(0.2, 0.7)))


def retroreflective(rgb: Colour, label: str, rng: np.random.Generator) -> Surface:
    """Return sign sheeting, faded with age; `rgb` is the linear albedo of new sheeting, such as `SIGN.red`."""
    fade = float(rng.uniform(0.55, 1.0))
    r, g, b = (float(c * fade + 0.12 * (1 - fade)) for c in rgb)
    return Surface(TAXONOMY[label], (r, g, b), float(rng.uniform(0.3, 0.8)) * fade, RETRO)


# Odd multipliers that spread lattice coordinates over 64 bits.
_X, _Y, _Z, _SEED = 0x1E3779B97F4A7C15, 0x2545F4914F6CDD1D, 0x369DEA0F31A53F85, 0x3C6EF372FE94F82A
_MIX = 0x14D049BB133111EB


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _scrambled(h: int) -> float:
    """Return a hash in [0, 1) of a sum of multiples of lattice coordinates."""
    h = (h ^ ((h >> 31) & 0x1FFFFFFFF)) * _MIX
    return ((h >> 40) & 0xFFFFFF) * (1.0 / 16777216.0)


@leaf
def lattice_value(ix: int, iy: int, iz: int) -> float:
    """Return the pseudo-random number in [0, 1) of a lattice point."""
    return _scrambled(ix * _X + iy * _Y + iz * _Z + _SEED)


@leaf
def plane_noise(x: float, y: float, layer: int) -> float:
    """Return smooth noise in [0, 1) with unit lattice spacing; each layer has its own pattern."""
    fx, fy = np.floor(x), np.floor(y)
    u, v = x - fx, y - fy
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    h = int(fx) * _X + int(fy) * _Y + layer * _Z + _SEED
    low, high = _scrambled(h), _scrambled(h + _Y)
    low += u * (_scrambled(h + _X) - low)
    high += u * (_scrambled(h + _X + _Y) - high)
    return low + v * (high - low)


@leaf
def value_noise(x: float, y: float, z: float) -> float:
    """Return smooth noise in [0, 1) with unit lattice spacing."""
    fz = np.floor(z)
    w = z - fz
    w *= w * (3 - 2 * w)
    low = plane_noise(x, y, int(fz))
    return low + w * (plane_noise(x, y, int(fz) + 1) - low)


@leaf
def texture_tone(kind: int, x: float, y: float, z: float) -> float:
    """Return the brightness factor, about 1, of a surface of a kind at a place."""
    if kind == BARK:
        return 0.7 + 0.6 * value_noise(x * 25, y * 25, z * 6)
    if kind == FOLIAGE:
        return 0.85 + 0.3 * value_noise(x * 2, y * 2, z * 2)
    if kind in (PAINT, GLASS, RETRO):
        return 0.95 + 0.1 * value_noise(x * 3, y * 3, z * 3)
    tone = 0.75 + 0.3 * value_noise(x * 0.9, y * 0.9, z * 0.5) + 0.2 * value_noise(x * 12, y * 12, z * 12)
    if kind == BRICK:
        course = z / 0.078
        if course - np.floor(course) < 0.14:
            return tone * 1.35
        return tone * (0.8 + 0.4 * lattice_value(int(np.floor((x + y) * 4.4)), 7, int(np.floor(course))))
    return tone


def foliage(name: str, label: str, rng: np.random.Generator) -> Surface:
    """Return the average leaf or petal of one plant, in a named colour such as ``"green"`` or ``"needle"``."""
    return _drawn(*_LEAVES[name], TAXONOMY[label], FOLIAGE, rng, (0.2, 0.08, 0.1), (0.05, 0.9))


def bark(name: str, label: str, rng: np.random.Generator) -> Surface:
    """Return the bark of one plant, in a named colour such as ``"brown"`` or ``"palm"``."""
    return _drawn(*_BARKS[name], TAXONOMY[label], BARK, rng, (0.22, 0.035, 0.11), (0.05, 0.9))


def same_as(surface: Surface, label: str) -> Surface:
    """Return the same material under another class."""
    return Surface(TAXONOMY[label], surface.rgb, surface.reflectivity, surface.kind)
