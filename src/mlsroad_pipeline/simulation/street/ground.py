"""Ground of a street: height and surface at every station and offset."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.street.alignment import STEP
from mlsroad_pipeline.simulation.street.junctions import (
    CROWN,
    HALF_WIDTH,
    REACH,
    ZEBRA,
    ZEBRA_HALF,
    edge_distance,
    first_row,
)

ROAD, LANE_MARKING, PARKING = TAXONOMY["road"], TAXONOMY["lane_marking"], TAXONOMY["parking"]
SIDEWALK, CURB, MANHOLE = TAXONOMY["sidewalk"], TAXONOMY["curb"], TAXONOMY["manhole"]
GRASS, SOIL, OTHER_GROUND = TAXONOMY["grass"], TAXONOMY["soil"], TAXONOMY["other_ground"]

GROUND_LABELS = (ROAD, LANE_MARKING, PARKING, SIDEWALK, CURB, MANHOLE, GRASS, SOIL, OTHER_GROUND)

CURB_FACE = 0.03
"""Horizontal run of the curb's face, metres."""

GUTTER = 0.3
"""Width of the gutter, metres."""

_GUTTER_DEPTH = 0.012


class Ground(NamedTuple):
    """Tables that determine the ground's height and surface; plain arrays, for compiled code."""

    start: float  # Station of the first row of the tables, metres
    # Per `STEP` of station: height of the centre line (m), remaining share of the curb's height on the left and on the
    # right (1 is full, less at a driveway), slope of the land beyond the property line, left and right
    profile: NDArray[np.float64]
    # Left and right: half width of the carriageway, width of the parking strip within it, of the curb, the verge and
    # the pavement, metres
    section: NDArray[np.float64]
    # Crown (slope), superelevation (slope), curb height (m), lane width (m), lanes per direction, half width of the
    # median (m), slant of parking bays (their run along the street per metre of depth; 0 is parallel parking), height
    # of the grass (m)
    shape: NDArray[np.float64]
    waves: NDArray[np.float64]  # Unevenness: wave numbers along and across (rad/m), phase, amplitude on the road (m)
    # Taxonomy code of the verge and of the land beyond the property line, per `STEP` of station
    verge: NDArray[np.uint8]
    lot: NDArray[np.uint8]  # Taxonomy code of the verge and of the land beyond the property line, per `STEP` of station
    # Station, offset and radius, sorted by station, metres; a negative radius is half the side of a square drain
    manholes: NDArray[np.float64]
    crossings: NDArray[np.float64]  # Station and half width of zebra crossings, sorted by station, metres
    # Side streets, sorted by station: station, side (0 is left), half width, corner radius, skew (tangent), curvature
    # of the main street there (1/m), traffic control, middle of its zebra crossing (metres beyond the main carriageway;
    # 0 is none), crown (slope). See `junctions`.
    arms: NDArray[np.float64]

    def height(self, station: ArrayLike, offset: ArrayLike) -> NDArray[np.float64]:
        """Return the height of the ground at stations and offsets, metres; constant profile beyond the ends."""
        s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
        flat = _heights(np.ascontiguousarray(s).ravel(), np.ascontiguousarray(left).ravel(), self)
        return flat.reshape(s.shape)

    def edge(self, station: ArrayLike, offset: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the distance to the nearest curb line and the street to which the land belongs.

        Distances are in metres, positive off the carriageway. Streets are rows of `arms`, -1 for the main street, -2
        for the median.
        """
        s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
        distance, arm = _edges(np.ascontiguousarray(s).ravel(), np.ascontiguousarray(left).ravel(), self)
        return distance.reshape(s.shape), arm.reshape(s.shape)

    def property_line(self, side: int) -> float:
        """Return the distance of the property line from the centre line, metres; side 0 is left."""
        return float(self.section[side, 0] + self.section[side, 2:].sum())

    def lane_centre(self, lane: int) -> float:
        """Return the distance from the centre line of the middle of a lane, metres; lane 0 is the innermost."""
        return float(self.shape[5] + (lane + 0.5) * self.shape[3])


@leaf
def _smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


@leaf
def _curb_left(full: float, d: float, t: float, arm: int, curb: float, ground: Ground) -> float:
    """Return the share of the curb's height left by driveways and crossings, at a distance from the curb line."""
    if arm >= 0 and ground.arms[arm, ZEBRA] > 0:
        gap = abs(t - ground.arms[arm, ZEBRA])
        full = min(full, max((gap - ZEBRA_HALF) / 0.9, 0.1))
    ramp = min(max((d - curb - 0.1) / 1.9, 0.0), 1.0)
    return 1.0 - (1.0 - min(full, 1.0)) * (1.0 - ramp)


@leaf
def ground_height(s: float, left: float, ground: Ground) -> float:
    """Return the height of the ground at one place, metres."""
    u = min(max((s - ground.start) / STEP, 0.0), len(ground.profile) - 1.000001)
    k = int(u)
    f = u - k
    side = 0 if left >= 0 else 1
    a = abs(left)
    low, high = ground.profile[k], ground.profile[k + 1]
    half, curb = ground.section[side, 0], ground.section[side, 2]
    width = curb + ground.section[side, 3] + ground.section[side, 4]
    median = ground.shape[5]
    z = low[0] + f * (high[0] - low[0]) + ground.shape[1] * left
    z -= ground.shape[0] * max(min(a, half) - median, 0.0)
    uneven = 0.0
    for w in range(len(ground.waves)):
        wave = ground.waves[w]
        uneven += wave[3] * np.sin(wave[0] * s + wave[1] * left + wave[2])
    if median < a < half - GUTTER - 0.1 or (median == 0 and a < half - GUTTER):
        return z + uneven
    first = first_row(ground.arms, s - REACH, 0)
    d, arm, t, q = edge_distance(s, left, ground.section, median, ground.arms, first)
    gutter = -_GUTTER_DEPTH * min(max(1.0 + d / GUTTER, 0.0), 1.0) if a > median else 0.0
    if arm == -2:
        full = min(low[1] + f * (high[1] - low[1]), low[2] + f * (high[2] - low[2]))
        step = ground.shape[2] * min(d / CURB_FACE, 1.0)
        bed = 0.04 * (1.0 - np.exp(-max(d - curb, 0.0)))  # soil is raised between the curbs
        return z + min(max(full, 0.1), 1.0) * (step + bed) + uneven
    if arm >= 0:  # the side street's own crown
        z += ground.arms[arm, CROWN] * max(ground.arms[arm, HALF_WIDTH] - abs(q), 0.0) * _smooth((t - 2.0) / 10.0)
    slope = low[3 + side] + f * (high[3 + side] - low[3 + side])
    beyond = max(a - half - width, 0.0)
    # The slope of the land levels out away from the street.
    z += slope * 15.0 * np.tanh(beyond / 15.0) * beyond / (beyond + 3.0)
    if d <= 0:
        return z + gutter + uneven
    full = _curb_left(low[1 + side] + f * (high[1 + side] - low[1 + side]), d, t, arm, curb, ground)
    z += gutter + (full * ground.shape[2] - gutter) * min(d / CURB_FACE, 1.0) + 0.02 * min(d, 8.0)
    # Gardens are rougher than roads.
    return z + uneven * (1.0 + 4.0 * min(max(d - width, 0.0), 1.0))


@njit(cache=True, nogil=True)
def _heights(s: NDArray[np.float64], left: NDArray[np.float64], ground: Ground) -> NDArray[np.float64]:
    z = np.empty(len(s))
    for i in range(len(s)):
        z[i] = ground_height(s[i], left[i], ground)
    return z


@njit(cache=True, nogil=True)
def _edges(
    s: NDArray[np.float64], left: NDArray[np.float64], ground: Ground
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    d, arm, first = np.empty(len(s)), np.empty(len(s), dtype=np.int64), 0
    for i in range(len(s)):
        first = first_row(ground.arms, s[i] - REACH, first)
        d[i], arm[i], _, _ = edge_distance(s[i], left[i], ground.section, ground.shape[5], ground.arms, first)
    return d, arm
