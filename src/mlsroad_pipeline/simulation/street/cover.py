"""Ground cover at a place: class, brightness, and height above the mesh of the ground."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.materials import lattice_value, plane_noise
from mlsroad_pipeline.simulation.street.alignment import STEP
from mlsroad_pipeline.simulation.street.ground import (
    CURB,
    GRASS,
    GUTTER,
    LANE_MARKING,
    MANHOLE,
    PARKING,
    ROAD,
    SIDEWALK,
    SOIL,
    Ground,
)
from mlsroad_pipeline.simulation.street.junctions import (
    LID,
    RADIUS,
    ZEBRA,
    ZEBRA_HALF,
    Nearby,
    bay_is_free,
    edge_distance,
    nearby,
)
from mlsroad_pipeline.simulation.street.markings import marked


@leaf
def _lid(s: float, left: float, holes: NDArray[np.float64], first: int) -> bool:
    for m in range(first, len(holes)):
        along, across, radius = holes[m, 0] - s, holes[m, 1] - left, holes[m, 2]
        if along > LID:
            return False
        if radius > 0 and along * along + across * across < radius * radius:
            return True
        if radius < 0 and max(abs(along), abs(across)) < -radius:
            return True
    return False


@leaf
def _on_carriageway(
    s: float, left: float, arm: int, t: float, q: float, section: NDArray[np.float64], shape: NDArray[np.float64],
    arms: NDArray[np.float64], crossings: NDArray[np.float64], holes: NDArray[np.float64],
    near: Nearby,
) -> int:  # fmt: skip
    if _lid(s, left, holes, near.hole):
        return MANHOLE
    if marked(s, left, arm, t, q, section, shape, arms, crossings, near):
        return LANE_MARKING
    side = 0 if left >= 0 else 1
    half, parking = section[side, 0], section[side, 1]
    bay = half - parking < abs(left) <= half and bay_is_free(s, side, section, arms, crossings, near)
    return PARKING if bay else ROAD


@leaf
def _off_carriageway(
    s: float, left: float, d: float, arm: int, t: float, start: float, section: NDArray[np.float64],
    arms: NDArray[np.float64], crossings: NDArray[np.float64], verge: NDArray[np.uint8], lot: NDArray[np.uint8],
    near: Nearby,
) -> int:  # fmt: skip
    side = 0 if left >= 0 else 1
    a = abs(left)
    curb, strip, pavement = section[side, 2], section[side, 3], section[side, 4]
    # Edges of grass and soil are ragged.
    row = int(min(max((s + 0.3 * lattice_value(int(a * 8), int(s * 8), 3) - start) / STEP, 0.0),
                  verge.shape[1] - 1.0))  # fmt: skip
    c = near.crossing
    paved = c >= 0 and abs(s - crossings[c, 0]) < crossings[c, 1]
    planted = verge[side, row]
    if arm == -2:
        planted = SOIL if verge[0, row] == SOIL else GRASS
    elif arm >= 0:
        zebra = arms[arm, ZEBRA]
        # Verges are trodden at corners.
        paved = t < max(zebra + ZEBRA_HALF, 0.7 * arms[arm, RADIUS])
    if arm != -2 and d > curb + strip + pavement:
        return int(lot[side, row])
    if not paved and (arm == -2 or d <= curb + strip):
        return int(planted)
    return SIDEWALK


@leaf
def _label(
    s: float, left: float, d: float, arm: int, t: float, q: float, start: float, section: NDArray[np.float64],
    shape: NDArray[np.float64], arms: NDArray[np.float64], crossings: NDArray[np.float64], holes: NDArray[np.float64],
    verge: NDArray[np.uint8], lot: NDArray[np.uint8], near: Nearby,
) -> int:  # fmt: skip
    if d <= 0:
        return _on_carriageway(s, left, arm, t, q, section, shape, arms, crossings, holes, near)
    if d <= section[0 if left >= 0 else 1, 2]:
        return CURB
    return _off_carriageway(s, left, d, arm, t, start, section, arms, crossings, verge, lot, near)


@leaf
def _even_noise(x: float, y: float, layer: int) -> float:
    """Return smooth noise with less contrast, as the mean of two layers has."""
    return 0.15 + 0.7 * plane_noise(x, y, layer)


@leaf
def surface_tone(label: int, s: float, left: float) -> float:
    """Return the brightness factor, about 1, of the ground at a place: patches, wear, tufts, slabs."""
    fine = plane_noise(s * 30, left * 30, label)
    patch = _even_noise(s * 0.35, left * 0.7, label + 64)
    if label == LANE_MARKING:
        worn = _even_noise(s * 5, left * 9, 1) + 0.4 * patch
        return 0.45 + 0.3 * fine if worn > 1.0 else 0.85 + 0.2 * fine
    if label == SIDEWALK:
        slab = lattice_value(int(np.floor(s / 0.6)), int(np.floor(left / 0.6)), 5)
        joint = 0.75 if (s % 0.6) < 0.015 or (left % 0.6) < 0.015 else 1.0
        return joint * (0.75 + 0.2 * slab + 0.15 * fine + 0.15 * patch)
    if label in (GRASS, SOIL):
        return 0.45 + 0.6 * fine + 0.5 * plane_noise(s * 2.2, left * 2.2, label + 128)
    if label in (ROAD, PARKING):
        repaired = 0.72 if lattice_value(int(np.floor(s / 7.0)), int(np.floor(left / 1.7)), 11) > 0.93 else 1.0
        return repaired * (0.72 + 0.25 * fine + 0.35 * patch)
    return 0.75 + 0.25 * fine + 0.25 * patch


@leaf
def _relief(label: int, s: float, left: float, tone: float, grass: float) -> float:
    if label == GRASS:
        # Beams penetrate between the blades; the depth varies within centimetres.
        tufts = _even_noise(s * 1.1, left * 1.1, 2)
        blade = grass * (0.4 + 1.2 * tufts * tufts)
        deep = lattice_value(int(np.floor(s * 160)), int(np.floor(left * 160)), 17)
        return blade * (1.0 - 0.8 * deep * deep)
    if label == SOIL:
        return 0.012 * (tone - 1.0) + 0.02 * max(_even_noise(s * 9, left * 9, 4) - 0.6, 0.0)
    if label == MANHOLE:  # lids are slightly sunk
        return -0.006
    return 0.003 * (tone - 1.0)


@leaf
def ground_cover(
    s: float, left: float, start: float, section: NDArray[np.float64], shape: NDArray[np.float64],
    arms: NDArray[np.float64], crossings: NDArray[np.float64], holes: NDArray[np.float64],
    verge: NDArray[np.uint8], lot: NDArray[np.uint8], near: Nearby,
) -> tuple[int, float, float]:  # fmt: skip
    """Return label, brightness factor (about 1) and relief (metres above the ground's mesh) of the cover at one place.

    Arrays are those of `Ground` (`holes` are its `manholes`): compiled code is several times faster with arrays than
    with the whole tuple. `near` are the rows where the search begins.
    """
    d, arm, t, q = edge_distance(s, left, section, shape[5], arms, near.arm)
    label = _label(s, left, d, arm, t, q, start, section, shape, arms, crossings, holes, verge, lot, near)
    tone = surface_tone(label, s, left)
    if -GUTTER < d <= 0 and label in (ROAD, PARKING):  # a row of gutter stones
        joint = 0.8 if (s % 0.5) < 0.012 or d > -0.012 else 1.0
        tone *= 1.45 * joint
    if label == MANHOLE and (s % 0.06) < 0.02:
        tone *= 0.6
    return label, tone, _relief(label, s, left, tone, shape[7])


@njit(cache=True, nogil=True, error_model="numpy")
def _labels(s: NDArray[np.float64], left: NDArray[np.float64], ground: Ground) -> NDArray[np.uint8]:
    codes = np.empty(len(s), dtype=np.uint8)
    start, section, shape, arms, crossings = ground.start, ground.section, ground.shape, ground.arms, ground.crossings
    holes, verge, lot = ground.manholes, ground.verge, ground.lot
    near = Nearby(0, 0, 0)
    for i in range(len(s)):
        near = nearby(s[i], arms, crossings, holes, near)
        d, arm, t, q = edge_distance(s[i], left[i], section, shape[5], arms, near.arm)
        codes[i] = _label(s[i], left[i], d, arm, t, q, start, section, shape, arms, crossings, holes, verge, lot, near)
    return codes


def ground_labels(ground: Ground, station: ArrayLike, offset: ArrayLike) -> NDArray[np.uint8]:
    """Return the taxonomy codes of the ground, of `GROUND_LABELS`, at stations and offsets, which broadcast."""
    s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
    flat = _labels(np.ascontiguousarray(s).ravel(), np.ascontiguousarray(left).ravel(), ground)
    return flat.reshape(s.shape)
