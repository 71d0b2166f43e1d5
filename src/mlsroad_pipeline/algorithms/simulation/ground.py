"""The ground of a street: its height and its surface at every station and offset."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.simulation.alignment import STEP
from mlsroad_pipeline.algorithms.simulation.materials import lattice_value, value_noise

ROAD, LANE_MARKING, PARKING = TAXONOMY["road"], TAXONOMY["lane_marking"], TAXONOMY["parking"]
SIDEWALK, CURB, MANHOLE = TAXONOMY["sidewalk"], TAXONOMY["curb"], TAXONOMY["manhole"]
GRASS, SOIL, OTHER_GROUND = TAXONOMY["grass"], TAXONOMY["soil"], TAXONOMY["other_ground"]

GROUND_LABELS = (ROAD, LANE_MARKING, PARKING, SIDEWALK, CURB, MANHOLE, GRASS, SOIL, OTHER_GROUND)

_GUTTER = 0.03  # horizontal run of the curb's face, metres


class Ground(NamedTuple):
    """Everything that the ground's height and surface depend on; plain arrays, for compiled code.

    Parameters
    ----------
    start : float
        Station of the first row of the tables, metres.
    profile : ndarray of shape (m, 5), float64
        Per `STEP` of station: height of the centre line (m), remaining share of the curb's height on the left and on
        the right (1 is full, less at a driveway), slope of the land beyond the property line, left and right.
    section : ndarray of shape (2, 5), float64
        Left and right: half width of the carriageway, width of the parking strip within it, of the curb, the verge
        and the pavement, metres.
    shape : ndarray of shape (5,), float64
        Crown (slope), superelevation (slope), curb height (m), lane width (m), lanes per direction.
    waves : ndarray of shape (k, 4), float64
        Unevenness: wave numbers along and across (rad/m), phase, amplitude on the road (m).
    verge, lot : ndarray of shape (2, m), uint8
        Taxonomy code of the verge and of the land beyond the property line, per `STEP` of station.
    manholes : ndarray of shape (q, 3), float64
        Station, offset and radius, sorted by station, metres.
    crossings : ndarray of shape (c, 2), float64
        Station and half width of zebra crossings, metres.
    """

    start: float
    profile: NDArray[np.float64]
    section: NDArray[np.float64]
    shape: NDArray[np.float64]
    waves: NDArray[np.float64]
    verge: NDArray[np.uint8]
    lot: NDArray[np.uint8]
    manholes: NDArray[np.float64]
    crossings: NDArray[np.float64]

    def height(self, station: ArrayLike, offset: ArrayLike) -> NDArray[np.float64]:
        """Return the height of the ground.

        Parameters
        ----------
        station, offset : array-like
            Metres along the centre line and to the left of it; shapes must broadcast. Beyond the tables' ends the
            profile is held.

        Returns
        -------
        ndarray of float64
            Heights in metres, in the shape that both broadcast to.
        """
        s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
        flat = _heights(np.ascontiguousarray(s).ravel(), np.ascontiguousarray(left).ravel(), self)
        return flat.reshape(s.shape)

    def labels(self, station: ArrayLike, offset: ArrayLike) -> NDArray[np.uint8]:
        """Return the taxonomy code of the ground's surface.

        Parameters
        ----------
        station, offset : array-like
            Metres along the centre line and to the left of it; shapes must broadcast.

        Returns
        -------
        ndarray of uint8
            Codes, each one of `GROUND_LABELS`, in the shape that both broadcast to.
        """
        s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
        flat = _labels(np.ascontiguousarray(s).ravel(), np.ascontiguousarray(left).ravel(), self)
        return flat.reshape(s.shape)

    def property_line(self, side: int) -> float:
        """Return the distance of the property line from the centre line, metres; side 0 is left."""
        return float(self.section[side, 0] + self.section[side, 2:].sum())


@njit(cache=True, nogil=True)
def ground_height(s: float, left: float, ground: Ground) -> float:
    """Return the height of the ground at one place, metres."""
    u = min(max((s - ground.start) / STEP, 0.0), len(ground.profile) - 1.000001)
    k = int(u)
    f = u - k
    side = 0 if left >= 0 else 1
    a = abs(left)
    low, high = ground.profile[k], ground.profile[k + 1]
    half, curb, verge, pavement = (
        ground.section[side, 0], ground.section[side, 2], ground.section[side, 3], ground.section[side, 4],
    )  # fmt: skip
    z = low[0] + f * (high[0] - low[0]) + ground.shape[1] * left
    uneven = 0.0
    for w in range(len(ground.waves)):
        wave = ground.waves[w]
        uneven += wave[3] * np.sin(wave[0] * s + wave[1] * left + wave[2])
    if a <= half:
        return z - ground.shape[0] * a + uneven
    full = low[1 + side] + f * (high[1 + side] - low[1 + side])
    z += -ground.shape[0] * half + full * ground.shape[2] * min((a - half) / _GUTTER, 1.0)
    z += 0.02 * (a - half)
    line = half + curb + verge + pavement
    if a <= line:
        return z + uneven
    slope = low[3 + side] + f * (high[3 + side] - low[3 + side])
    beyond = a - line
    # Gardens are rougher than roads, and the land levels out away from the street.
    return z + slope * 15.0 * np.tanh(beyond / 15.0) + uneven * (1.0 + 4.0 * min(beyond, 1.0))


@njit(cache=True, nogil=True)
def _marking(s: float, left: float, half_lane_area: float, parking: float, ground: Ground) -> bool:
    a = abs(left)
    lane, lanes = ground.shape[3], ground.shape[4]
    for c in range(len(ground.crossings)):
        if abs(s - ground.crossings[c, 0]) < ground.crossings[c, 1]:
            return a < half_lane_area - 0.3 and (left % 1.0) < 0.5
        if abs(s - ground.crossings[c, 0]) < ground.crossings[c, 1] + 12.0:
            if a < 0.07:
                return True
            gap = (ground.crossings[c, 0] - s) * (1.0 if left < 0 else -1.0) - ground.crossings[c, 1]
            if 1.2 < gap < 1.6 and 0.3 < a < half_lane_area - 0.3:
                return True
    dashed = (s % 9.0) < 3.0
    if a < 0.065:
        return dashed or lanes > 1
    edge = a - half_lane_area
    side_line = abs(edge + 0.28) < 0.06
    if parking > 0:
        side_line = abs(edge) < 0.06 or (edge > 0 and (s % 5.8) < 0.1)
    return side_line or (lanes > 1 and dashed and abs(a - lane) < 0.06)


@njit(cache=True, nogil=True)
def ground_label(s: float, left: float, ground: Ground) -> int:
    """Return the taxonomy code of the ground's surface at one place."""
    side = 0 if left >= 0 else 1
    a = abs(left)
    half, parking, curb, verge, pavement = ground.section[side]
    row = int(min(max((s + 0.3 * lattice_value(int(a * 8), int(s * 8), 3) - ground.start) / STEP, 0.0),
                  ground.verge.shape[1] - 1.0))  # fmt: skip
    holes = ground.manholes
    first = np.searchsorted(holes[:, 0], s - 0.5)
    for m in range(first, len(holes)):
        if holes[m, 0] > s + 0.5:
            break
        if (holes[m, 0] - s) ** 2 + (holes[m, 1] - left) ** 2 < holes[m, 2] ** 2:
            return MANHOLE
    if a <= half:
        if _marking(s, left, half - parking, parking, ground):
            return LANE_MARKING
        return PARKING if a > half - parking else ROAD
    code = ground.lot[side, row]
    if a <= half + curb:
        code = CURB
    elif a <= half + curb + verge:
        code = ground.verge[side, row]
    elif a <= half + curb + verge + pavement:
        code = SIDEWALK
    return code


@njit(cache=True, nogil=True)
def surface_tone(label: int, s: float, left: float) -> float:
    """Return the factor, about 1, by which the ground is lighter or darker at a place: patches, wear, tufts, slabs."""
    fine = value_noise(s * 30, left * 30, label)
    patch = value_noise(s * 0.35, left * 0.7, label + 0.5)
    if label == LANE_MARKING:
        worn = value_noise(s * 5, left * 9, 0.5) + 0.4 * patch
        return 0.45 + 0.3 * fine if worn > 1.0 else 0.85 + 0.2 * fine
    if label == SIDEWALK:
        slab = lattice_value(int(np.floor(s / 0.6)), int(np.floor(left / 0.6)), 5)
        joint = 0.75 if (s % 0.6) < 0.015 or (left % 0.6) < 0.015 else 1.0
        return joint * (0.75 + 0.2 * slab + 0.15 * fine + 0.15 * patch)
    if label in (GRASS, SOIL):
        return 0.45 + 0.6 * fine + 0.5 * value_noise(s * 2.2, left * 2.2, label)
    if label in (ROAD, PARKING):
        repaired = 0.72 if lattice_value(int(np.floor(s / 7.0)), int(np.floor(left / 1.7)), 11) > 0.93 else 1.0
        return repaired * (0.72 + 0.25 * fine + 0.35 * patch)
    return 0.75 + 0.25 * fine + 0.25 * patch


@njit(cache=True, nogil=True)
def _heights(s: NDArray[np.float64], left: NDArray[np.float64], ground: Ground) -> NDArray[np.float64]:
    z = np.empty(len(s))
    for i in range(len(s)):
        z[i] = ground_height(s[i], left[i], ground)
    return z


@njit(cache=True, nogil=True)
def _labels(s: NDArray[np.float64], left: NDArray[np.float64], ground: Ground) -> NDArray[np.uint8]:
    codes = np.empty(len(s), dtype=np.uint8)
    for i in range(len(s)):
        codes[i] = ground_label(s[i], left[i], ground)
    return codes
