"""What rays met, and what is there: label, albedo and relief of the place, textures and ground covers looked up."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.alignment import locate_one
from mlsroad_pipeline.algorithms.simulation.cover import ground_cover
from mlsroad_pipeline.algorithms.simulation.ground import Ground
from mlsroad_pipeline.algorithms.simulation.materials import texture_tone
from mlsroad_pipeline.algorithms.simulation.meshes import GROUND, KIND, LABEL, RED


class Hits(NamedTuple):
    """What rays met first.

    Parameters
    ----------
    distance : ndarray of shape (n,), float32
        Metres along the ray; infinite where it met nothing.
    face : ndarray of shape (n,), int32
        Row of the scene's attribute table, -1 where it met nothing.
    normal : ndarray of shape (n, 3), float32
        Unit normal of the face, either side.
    """

    distance: NDArray[np.float32]
    face: NDArray[np.int32]
    normal: NDArray[np.float32]


class Surfaces(NamedTuple):
    """What the places are made of that rays met.

    Parameters
    ----------
    label, kind : ndarray of shape (n,), uint8
        Taxonomy code and kind of the surface.
    rgb : ndarray of shape (n, 3), float32
        Linear albedo.
    reflectivity : ndarray of shape (n,), float32
        Albedo at the scanner's wavelength.
    relief : ndarray of shape (n,), float32
        Height of what grows or lies on the ground there, metres.
    """

    label: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    rgb: NDArray[np.float32]
    reflectivity: NDArray[np.float32]
    relief: NDArray[np.float32]


@njit(cache=True, nogil=True)
def resolve_hits(
    distance: NDArray[np.float32], face: NDArray[np.int32], rays: NDArray[np.float32],
    attributes: NDArray[np.float32], centre: NDArray[np.float64], table: NDArray[np.float64], ground: Ground,
    ground_rgb: NDArray[np.float64], ground_reflectivity: NDArray[np.float64], near: float,
) -> Surfaces:  # fmt: skip
    """Return what the places are made of that rays met; see `RayScene.resolve`."""
    n = len(face)
    label, kind = np.zeros(n, dtype=np.uint8), np.zeros(n, dtype=np.uint8)
    rgb, reflectivity = np.zeros((n, 3), dtype=np.float32), np.zeros(n, dtype=np.float32)
    relief = np.zeros(n, dtype=np.float32)
    guess = near
    for i in range(n):
        if face[i] < 0:
            continue
        row = attributes[face[i]]
        kind[i] = np.uint8(row[KIND])
        x = centre[0] + rays[i, 0] + distance[i] * rays[i, 3]
        y = centre[1] + rays[i, 1] + distance[i] * rays[i, 4]
        if kind[i] == GROUND:
            s, left = locate_one(x, y, table, ground.start, guess)
            guess = s
            code, tone, relief[i] = ground_cover(s, left, ground)
            label[i] = code
            for c in range(3):
                rgb[i, c] = min(ground_rgb[code, c] * tone, 1.0)
            reflectivity[i] = min(ground_reflectivity[code] * (0.5 + 0.5 * tone), 0.98)
        else:
            z = centre[2] + rays[i, 2] + distance[i] * rays[i, 5]
            tone = texture_tone(int(kind[i]), x, y, z)
            label[i] = np.uint8(row[LABEL])
            for c in range(3):
                rgb[i, c] = min(row[RED + c] * tone, 1.0)
            reflectivity[i] = min(row[RED + 3] * (0.5 + 0.5 * tone), 0.98)
    return Surfaces(label, kind, rgb, reflectivity, relief)
