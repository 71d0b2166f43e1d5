"""Ground of a street: height and edges at every station and offset, with side streets and a median."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.street.alignment import STEP

# Columns of `Ground.arms`.
STATION, SIDE, HALF_WIDTH, RADIUS, SKEW, CURVATURE, CONTROL, ZEBRA, CROWN = range(9)

GIVE_WAY, STOP, SIGNALS = range(3)  # Control of traffic from a side street: column `CONTROL`
REACH = 45.0  # Largest distance of a side street's land from its junction, along the main street, metres
ZEBRA_HALF = 1.6  # Half width of the zebra crossing over a side street's mouth, metres
LID = 0.6  # Largest half length of a manhole or a drain along the street, metres
ROAD, LANE_MARKING, PARKING = TAXONOMY["road"], TAXONOMY["lane_marking"], TAXONOMY["parking"]
SIDEWALK, CURB, MANHOLE = TAXONOMY["sidewalk"], TAXONOMY["curb"], TAXONOMY["manhole"]
GRASS, SOIL, OTHER_GROUND = TAXONOMY["grass"], TAXONOMY["soil"], TAXONOMY["other_ground"]
CURB_FACE = 0.03  # Horizontal run of the curb's face, metres
GUTTER = 0.3  # Width of the gutter, metres
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
    # 0 is none), crown (slope).
    arms: NDArray[np.float64]

    def height(self, station: ArrayLike, offset: ArrayLike) -> NDArray[np.float64]:
        """Return the height of the ground at stations and offsets, metres; constant profile beyond the ends."""
        s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
        flat = _heights(np.ascontiguousarray(s).ravel(), np.ascontiguousarray(left).ravel(), self)
        return flat.reshape(s.shape)

    def edge(self, station: ArrayLike, offset: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the distance to the nearest curb line, metres, positive off the carriageway, and the street there.

        Streets are rows of `arms`, -1 for the main street, -2 for the median.
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


class Nearby(NamedTuple):
    """Rows of the tables of `Ground` near a place."""

    arm: int  # The first side street whose land can reach it
    crossing: int  # The nearest zebra crossing, -1 without one
    hole: int  # The first manhole or drain that can reach it


@leaf
def first_row(table: NDArray[np.float64], station: float, guess: int) -> int:
    """Return the first row at or after a station in a table sorted by column 0; the search begins at `guess`."""
    k = min(max(guess, 0), len(table))
    while k > 0 and table[k - 1, 0] >= station:
        k -= 1
    while k < len(table) and table[k, 0] < station:
        k += 1
    return k


@leaf
def nearby(s: float, ground: Ground, last: Nearby) -> Nearby:
    """Return the rows near a station; `last`, those of another place, only saves time."""
    crossings = ground.crossings
    c = first_row(crossings, s, last.crossing)
    if c == len(crossings) or (c > 0 and s - crossings[c - 1, 0] < abs(crossings[c, 0] - s)):
        c -= 1
    return Nearby(first_row(ground.arms, s - REACH, last.arm), c, first_row(ground.manholes, s - LID, last.hole))


@leaf
def rounded(a: float, b: float, radius: float) -> float:
    """Return the lesser of two distances, its level lines rounded to arcs where both are below a radius."""
    u, v = max(radius - a, 0.0), max(radius - b, 0.0)
    return max(radius, min(a, b)) - np.sqrt(u * u + v * v)


@leaf
def arm_coordinates(s: float, left: float, half: float, arm: NDArray[np.float64]) -> tuple[float, float]:
    """Return t, the distance beyond the main carriageway's edge, and q, that from the side street's axis, metres.

    `half` is the half width of the main carriageway on the arm's side; q is positive along the main street.
    """
    t = abs(left) - half
    # Stations fan out on the outside of a bend; a side street keeps its width.
    q = (s - arm[STATION]) * (1.0 - arm[CURVATURE] * left) - arm[SKEW] * t
    return t, q / np.sqrt(1.0 + arm[SKEW] ** 2)


@leaf
def hold_line(arm: NDArray[np.float64]) -> float:
    """Return where traffic from a side street waits, metres beyond the main carriageway."""
    return arm[ZEBRA] + ZEBRA_HALF + 1.0 if arm[ZEBRA] > 0 else 0.75 * arm[RADIUS]


@leaf
def edge_distance(s: float, left: float, ground: Ground, first: int) -> tuple[float, int, float, float]:
    """Return the distance to the nearest curb line (metres, positive off the carriageway), its street, t and q.

    The street is a row of `arms`, -1 for the main street, -2 for the median; t and q are the place along and across a
    side street, else 0. The search begins at the arm `first`.
    """
    side = 0 if left >= 0 else 1
    a, arms, median = abs(left), ground.arms, ground.shape[5]
    half = ground.section[side, 0]
    best, which, along, across = a - half, -1, 0.0, 0.0
    inner = median - a
    for k in range(first, len(arms)):
        arm = arms[k]
        if arm[STATION] > s + REACH:
            break
        if inner > 0:
            gap = abs(s - arm[STATION]) - arm[HALF_WIDTH] - 0.6 * arm[RADIUS]
            inner = min(inner, rounded(median - a, gap, 0.95 * median))
        if int(arm[SIDE]) != side:
            continue
        t, q = arm_coordinates(s, left, half, arm)
        d = rounded(a - half, abs(q) - arm[HALF_WIDTH], arm[RADIUS])
        if d < best - 1e-9:
            best, which, along, across = d, k, t, q
    if inner > 0:
        return inner, -2, 0.0, 0.0
    if median > 0:
        best = max(best, inner)
    return best, which, along, across


@leaf
def bay_is_free(s: float, side: int, ground: Ground, near: Nearby) -> bool:
    """Return whether parking is allowed at the curb: not within 5 m of a junction, nor at a zebra crossing."""
    arms, crossings = ground.arms, ground.crossings
    if ground.section[side, 1] == 0:
        return False
    for k in range(near.arm, len(arms)):
        if arms[k, STATION] > s + REACH:
            break
        if int(arms[k, SIDE]) == side and abs(s - arms[k, STATION]) < arms[k, HALF_WIDTH] + arms[k, RADIUS] + 5.0:
            return False
    c = near.crossing
    return c < 0 or abs(s - crossings[c, 0]) >= crossings[c, 1] + 4.0


def corner_curve(
    arm: NDArray[np.float64], half: float, distance: float, depth: float, direction: int
) -> NDArray[np.float64]:
    """Return stations and offsets of a line at a distance from the curb, around a corner of a side street and along it.

    `depth` is the largest distance from the main street's axis; `direction` is 1 for the corner ahead along the main
    street, -1 for the one behind. Points are about a quarter of a metre apart.
    """
    radius = float(arm[RADIUS])
    angle = np.linspace(0, np.pi / 2, max(int(radius * 6.5), 8))
    beyond = np.append(np.arange(radius + 0.25, depth - half - 0.1, 0.25), depth - half)
    before = np.arange(1.0, 0.1, -0.25)
    t = np.concatenate([np.full(4, distance), radius - (radius - distance) * np.cos(angle), beyond])
    y = np.concatenate([radius + before, radius - (radius - distance) * np.sin(angle), np.full(len(beyond), distance)])
    return arm_places(arm, half, t, direction * (arm[HALF_WIDTH] + y))


def arm_places(arm: NDArray[np.float64], half: float, t: ArrayLike, q: ArrayLike) -> NDArray[np.float64]:
    """Return stations and offsets, (n, 2), of places along and across a side street; see `arm_coordinates`."""
    along, across = np.broadcast_arrays(np.asarray(t, dtype=np.float64), np.asarray(q, dtype=np.float64))
    left = (half + along) * (1.0 if arm[SIDE] == 0 else -1.0)
    way = across * np.sqrt(1 + arm[SKEW] ** 2) + arm[SKEW] * along
    return np.stack([arm[STATION] + way / (1 - arm[CURVATURE] * left), left], axis=-1)


def arm_place(arm: NDArray[np.float64], half: float, t: float, q: float) -> tuple[float, float]:
    """Return station and offset of one place; see `arm_places`."""
    s, left = arm_places(arm, half, t, q)
    return float(s), float(left)


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
    d, arm, t, q = edge_distance(s, left, ground, first)
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
        d[i], arm[i], _, _ = edge_distance(s[i], left[i], ground, first)
    return d, arm
