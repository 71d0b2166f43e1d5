"""Hits of rays, and the surfaces there: label, albedo and relief, with textures and ground covers."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.materials import plane_noise, texture_tone
from mlsroad_pipeline.simulation.model.meshes import GROUND, KIND, LABEL, RED
from mlsroad_pipeline.simulation.street.alignment import locate_one
from mlsroad_pipeline.simulation.street.cover import ground_cover
from mlsroad_pipeline.simulation.street.ground import GRASS, SOIL, Ground, Nearby, nearby

WET = 8  # Kind of ground under a film of water, assigned to places, not to faces; see `meshes` for the other kinds
_CLOSE = 0.15  # last step of the search along the street, metres; the error is then tenths of a millimetre

_SHARES = np.array([0.0, 0.01, 0.03, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 0.99, 1.0])
_LEVELS = np.array([0.0, 0.157, 0.209, 0.291, 0.409, 0.5, 0.591, 0.709, 0.791, 0.843, 1.0])


class Hits(NamedTuple):
    """First hits of rays."""

    distance: NDArray[np.float32]  # Metres along the ray; infinite without a hit
    face: NDArray[np.int32]  # Row of the scene's attribute table, -1 without a hit
    normal: NDArray[np.float32]  # Unit normal of the face, of either sign


class Surfaces(NamedTuple):
    """Surfaces at the hits of rays."""

    # label, kind: taxonomy code and kind of the surface
    label: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    rgb: NDArray[np.float32]  # Linear albedo
    reflectivity: NDArray[np.float32]  # Albedo at the scanner's wavelength
    relief: NDArray[np.float32]  # Height of vegetation or grain on the ground there, metres


def water_level(wetness: float) -> float:
    """Return the quantile of the unevenness noise below which a share of the ground, 0 to 1, is under water."""
    return float(np.interp(wetness, _SHARES, _LEVELS))


@leaf
def _is_wet(label: int, x: float, y: float, water: float) -> bool:
    """Return whether a film of water covers the ground at a place: puddles of some metres on paved ground."""
    if label in (GRASS, SOIL):
        return False
    coarse = 0.65 * plane_noise(x * 0.35, y * 0.35, 5)
    return coarse < water and coarse + 0.35 * plane_noise(x * 1.3, y * 1.3, 5) < water


@njit(cache=True, nogil=True, error_model="numpy")
def resolve_hits(
    distance: NDArray[np.float32], face: NDArray[np.int32], rays: NDArray[np.float32],
    attributes: NDArray[np.float32], centre: NDArray[np.float64], table: NDArray[np.float64], ground: Ground,
    ground_rgb: NDArray[np.float64], ground_reflectivity: NDArray[np.float64], near: float, water: float,
) -> Surfaces:  # fmt: skip
    """Return the surfaces at hits; see `RayScene.resolve`."""
    n = len(face)
    label, kind = np.zeros(n, dtype=np.uint8), np.zeros(n, dtype=np.uint8)
    rgb, reflectivity = np.zeros((n, 3), dtype=np.float32), np.zeros(n, dtype=np.float32)
    relief = np.zeros(n, dtype=np.float32)
    guess, rows = near, Nearby(0, 0, 0)
    for i in range(n):
        if face[i] < 0:
            continue
        row = attributes[face[i]]
        kind[i] = np.uint8(row[KIND])
        x = centre[0] + rays[i, 0] + distance[i] * rays[i, 3]
        y = centre[1] + rays[i, 1] + distance[i] * rays[i, 4]
        if kind[i] == GROUND:
            s, left = locate_one(x, y, table, ground.start, guess, _CLOSE)
            guess, rows = s, nearby(s, ground, rows)
            code, tone, relief[i] = ground_cover(s, left, ground, rows)
            label[i] = code
            for c in range(3):
                rgb[i, c] = min(ground_rgb[code, c] * tone, 1.0)
            reflectivity[i] = min(ground_reflectivity[code] * (0.5 + 0.5 * tone), 0.98)
            if water > 0 and _is_wet(code, x, y, water):
                kind[i], relief[i] = WET, 0.0
                reflectivity[i] *= 0.3
                for c in range(3):
                    rgb[i, c] *= 0.55
        else:
            z = centre[2] + rays[i, 2] + distance[i] * rays[i, 5]
            tone = texture_tone(int(kind[i]), x, y, z)
            label[i] = np.uint8(row[LABEL])
            for c in range(3):
                rgb[i, c] = min(row[RED + c] * tone, 1.0)
            reflectivity[i] = min(row[RED + 3] * (0.5 + 0.5 * tone), 0.98)
    return Surfaces(label, kind, rgb, reflectivity, relief)
