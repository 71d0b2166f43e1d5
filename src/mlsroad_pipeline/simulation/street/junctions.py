"""Where side streets join: the distance to the nearest curb line, rounded at corners and at the ends of a median."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf

# Columns of `Ground.arms`.
STATION, SIDE, HALF_WIDTH, RADIUS, SKEW, CURVATURE, CONTROL, ZEBRA, CROWN = range(9)

GIVE_WAY, STOP, SIGNALS = range(3)
"""How traffic from a side street is held: column `CONTROL`."""

REACH = 45.0
"""How far along the main street a side street's land can lie from where it joins, metres."""

ZEBRA_HALF = 1.6
"""Half width of the zebra crossing over a side street's mouth, metres."""

LID = 0.6
"""How far along the street a manhole or a drain can reach from its middle, metres."""


class Nearby(NamedTuple):
    """Where in the tables of `Ground` to look for what is near a place.

    Parameters
    ----------
    arm : int
        The first side street whose land can reach there.
    crossing : int
        The nearest zebra crossing, -1 where there is none.
    hole : int
        The first manhole or drain that can.
    """

    arm: int
    crossing: int
    hole: int


@leaf
def first_row(table: NDArray[np.float64], station: float, guess: int) -> int:
    """Return the first row of a table, sorted by its first column, that does not lie before a station.

    Parameters
    ----------
    table : ndarray of shape (n, k), float64
        Stations in column 0, metres.
    station : float
        Metres.
    guess : int
        A row to begin the search at; the answer does not depend on it.

    Returns
    -------
    int
        From 0 to n.
    """
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
    """Return where to look for what is near a station.

    Parameters
    ----------
    s : float
        Station, metres.
    arms, crossings, holes : ndarray
        Those of `Ground`, `holes` its `manholes`.
    last : Nearby
        The answer for a place near by, or any other; it only saves time.

    Returns
    -------
    Nearby
        Rows.
    """
    c = first_row(crossings, s, last.crossing)
    if c == len(crossings) or (c > 0 and s - crossings[c - 1, 0] < abs(crossings[c, 0] - s)):
        c -= 1
    return Nearby(first_row(arms, s - REACH, last.arm), c, first_row(holes, s - LID, last.hole))


@leaf
def rounded(a: float, b: float, radius: float) -> float:
    """Return the lesser of two distances, its level lines rounded to arcs where both are below a radius.

    Parameters
    ----------
    a, b : float
        Distances to two edges, metres.
    radius : float
        Of the arc that the zero line follows where the edges meet, metres.

    Returns
    -------
    float
        Metres.
    """
    u, v = max(radius - a, 0.0), max(radius - b, 0.0)
    return max(radius, min(a, b)) - np.sqrt(u * u + v * v)


@leaf
def arm_coordinates(s: float, left: float, half: float, arm: NDArray[np.float64]) -> tuple[float, float]:
    """Return where a place lies along and across a side street, metres.

    Parameters
    ----------
    s, left : float
        Station and offset, metres.
    half : float
        Half width of the main carriageway on the arm's side, metres.
    arm : ndarray of shape (9,), float64
        Row of `Ground.arms`.

    Returns
    -------
    t : float
        Distance beyond the edge of the main carriageway.
    q : float
        Distance from the side street's axis, positive along the main street.
    """
    t = abs(left) - half
    # Stations fan out on the outside of a bend; a side street keeps its width.
    q = (s - arm[STATION]) * (1.0 - arm[CURVATURE] * left) - arm[SKEW] * t
    return t, q / np.sqrt(1.0 + arm[SKEW] ** 2)


@leaf
def edge_distance(
    s: float, left: float, section: NDArray[np.float64], median: float, arms: NDArray[np.float64], first: int
) -> tuple[float, int, float, float]:
    """Return the distance to the nearest curb line, positive off the carriageway.

    Parameters
    ----------
    s, left : float
        Station and offset, metres.
    section : ndarray of shape (2, 5), float64
        See `Ground`.
    median : float
        Half width of the median, metres; 0 is none.
    arms : ndarray of shape (k, 9), float64
        Side streets, sorted by station.
    first : int
        The first of them to look at, as `Nearby` has it.

    Returns
    -------
    distance : float
        Metres.
    arm : int
        Row of the side street whose land this is, -1 for the main street, -2 for the median.
    t, q : float
        Place along and across that side street; 0 without one.
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
    """Tell whether cars may stand at the curb: not within 5 m of a junction, nor at a zebra crossing.

    Parameters
    ----------
    s : float
        Station, metres.
    side : int
        0 is left.
    section, arms, crossings : ndarray
        See `Ground`.
    near : Nearby
        Where to look in them.

    Returns
    -------
    bool
        True where the parking strip is marked.
    """
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
    """Return a line at a constant distance from the curb round one corner of a side street and on along it.

    Parameters
    ----------
    arm : ndarray of shape (9,), float64
        Row of `Ground.arms`.
    half : float
        Half width of the main carriageway on the arm's side, metres.
    distance : float
        From the curb line, metres.
    depth : float
        Largest distance from the main street's axis, metres.
    direction : int
        1 for the corner ahead along the main street, -1 for the one behind.

    Returns
    -------
    ndarray of shape (m, 2), float64
        Stations and offsets, about a quarter of a metre apart.
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
    """Return station and offset of a place given along and across a side street; the inverse of `arm_coordinates`.

    Parameters
    ----------
    arm : ndarray of shape (9,), float64
        Row of `Ground.arms`.
    half : float
        Half width of the main carriageway on the arm's side, metres.
    t, q : float
        Along and across, metres.

    Returns
    -------
    station, offset : float
        Metres.
    """
    left = (half + t) * (1.0 if arm[SIDE] == 0 else -1.0)
    s = arm[STATION] + (q * np.sqrt(1 + arm[SKEW] ** 2) + arm[SKEW] * t) / (1 - arm[CURVATURE] * left)
    return float(s), float(left)
