"""Side streets: the distance to the nearest curb line, rounded at corners and at the ends of a median."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf

# Columns of `Ground.arms`.
STATION, SIDE, HALF_WIDTH, RADIUS, SKEW, CURVATURE, CONTROL, ZEBRA, CROWN = range(9)

GIVE_WAY, STOP, SIGNALS = range(3)
"""Control of traffic from a side street: column `CONTROL`."""

REACH = 45.0
"""Largest distance of a side street's land from its junction, along the main street, metres."""

ZEBRA_HALF = 1.6
"""Half width of the zebra crossing over a side street's mouth, metres."""

LID = 0.6
"""Largest half length of a manhole or a drain along the street, metres."""


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
def nearby(
    s: float, arms: NDArray[np.float64], crossings: NDArray[np.float64], holes: NDArray[np.float64], last: Nearby
) -> Nearby:
    """Return the rows near a station; `last`, those of another place, only saves time."""
    c = first_row(crossings, s, last.crossing)
    if c == len(crossings) or (c > 0 and s - crossings[c - 1, 0] < abs(crossings[c, 0] - s)):
        c -= 1
    return Nearby(first_row(arms, s - REACH, last.arm), c, first_row(holes, s - LID, last.hole))


@leaf
def rounded(a: float, b: float, radius: float) -> float:
    """Return the lesser of two distances, its level lines rounded to arcs where both are below a radius."""
    u, v = max(radius - a, 0.0), max(radius - b, 0.0)
    return max(radius, min(a, b)) - np.sqrt(u * u + v * v)


@leaf
def arm_coordinates(s: float, left: float, half: float, arm: NDArray[np.float64]) -> tuple[float, float]:
    """Return t, the distance beyond the main carriageway's edge, and q, that from the side street's axis, metres.

    `half` is the half width of the main carriageway on the arm's side, `arm` a row of `Ground.arms`; q is positive
    along the main street.
    """
    t = abs(left) - half
    # Stations fan out on the outside of a bend; a side street keeps its width.
    q = (s - arm[STATION]) * (1.0 - arm[CURVATURE] * left) - arm[SKEW] * t
    return t, q / np.sqrt(1.0 + arm[SKEW] ** 2)


@leaf
def edge_distance(
    s: float, left: float, section: NDArray[np.float64], median: float, arms: NDArray[np.float64], first: int
) -> tuple[float, int, float, float]:
    """Return the distance to the nearest curb line (metres, positive off the carriageway), its street, t and q.

    `median` is the half width of the median, 0 without one. The street is a row of `arms`, -1 for the main street, -2
    for the median; t and q are the place along and across a side street, else 0. The search begins at the arm `first`.
    """
    side = 0 if left >= 0 else 1
    a = abs(left)
    half = section[side, 0]
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
def bay_is_free(
    s: float, side: int, section: NDArray[np.float64], arms: NDArray[np.float64], crossings: NDArray[np.float64],
    near: Nearby,
) -> bool:  # fmt: skip
    """Return whether parking is allowed at the curb: not within 5 m of a junction, nor at a zebra crossing."""
    if section[side, 1] == 0:
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
    sign = 1.0 if arm[SIDE] == 0 else -1.0
    left = sign * (half + t)
    q = direction * (arm[HALF_WIDTH] + y)
    s = arm[STATION] + (q * np.sqrt(1 + arm[SKEW] ** 2) + arm[SKEW] * t) / (1 - arm[CURVATURE] * left)
    return np.stack([s, left], axis=1)


def arm_place(arm: NDArray[np.float64], half: float, t: float, q: float) -> tuple[float, float]:
    """Return station and offset of a place along and across a side street; the inverse of `arm_coordinates`."""
    left = (half + t) * (1.0 if arm[SIDE] == 0 else -1.0)
    s = arm[STATION] + (q * np.sqrt(1 + arm[SKEW] ** 2) + arm[SKEW] * t) / (1 - arm[CURVATURE] * left)
    return float(s), float(left)
