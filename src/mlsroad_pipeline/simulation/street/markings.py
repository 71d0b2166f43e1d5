"""Road markings: lane, edge and bay lines, stop and give-way lines, arrows and zebra crossings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.street.junctions import (
    CONTROL,
    GIVE_WAY,
    HALF_WIDTH,
    RADIUS,
    REACH,
    SIDE,
    SIGNALS,
    STATION,
    ZEBRA,
    ZEBRA_HALF,
    Nearby,
    bay_is_free,
)

BAY = 5.8
"""Length of a parallel parking bay, metres."""

SLANTED_BAY = 2.9
"""Length along the curb of a slanted one, metres."""

_LINE = 0.06  # half width of a painted line, metres
_ARROW = 5.0  # metres


@leaf
def _arrow(ahead: float, across: float, turns: int) -> bool:
    """Return whether an arrow covers a place given from its tail; turns is 0 straight on, 1 left too, -1 right too."""
    if not (0.0 <= ahead <= _ARROW and abs(across) < 0.8):
        return False
    if abs(across) < 0.09 and ahead < 3.4:
        return True
    if ahead > 3.3 and abs(across) < 0.3 * (_ARROW - ahead) / 1.7:
        return True
    if turns != 0:
        y = across * turns
        if abs(ahead - 1.9 - 0.4 * y) < 0.12 and 0.0 < y < 0.45:
            return True
        return bool(0.4 < y < 0.8 and abs(ahead - 2.08) < 0.9 * (0.8 - y))
    return False


@leaf
def _side_street(t: float, q: float, row: NDArray[np.float64]) -> bool:
    """Return whether a place of a side street is painted."""
    half, zebra = row[HALF_WIDTH], row[ZEBRA]
    if zebra > 0 and abs(t - zebra) < ZEBRA_HALF:
        return abs(q) < half - 0.25 and (q % 1.0) < 0.5
    entering = q < 0 if row[SIDE] == 0 else q > 0
    hold = zebra + ZEBRA_HALF + 1.0 if zebra > 0 else 0.75 * row[RADIUS]
    if hold < t < hold + 0.4 and entering and 0.2 < abs(q) < half - 0.2:
        return int(row[CONTROL]) != GIVE_WAY or (q % 0.75) < 0.5
    if t > hold and abs(q) < _LINE:
        return t < hold + 10.0 or (t % 6.0) < 3.0
    return False


@leaf
def _near_junction(
    s: float, left: float, arms: NDArray[np.float64], shape: NDArray[np.float64], lane_edge: float, first: int
) -> int:
    """Return 0 away from junctions, 1 at the mouth of a side street, 2 on an arrow, 3 opposite a side street."""
    for k in range(first, len(arms)):
        row = arms[k]
        along = s - row[STATION]
        if along > REACH:
            continue
        if along < -REACH:
            break
        mouth = row[HALF_WIDTH] + row[RADIUS]
        same = (left >= 0) == (int(row[SIDE]) == 0)
        if abs(along) < mouth + 0.5:
            return 1 if same or abs(left) < shape[5] + 0.5 else 3
        if int(row[CONTROL]) != SIGNALS or abs(left) > lane_edge:
            continue
        # Traffic on the right runs ahead along the street, on the left back.
        before = -along if left < 0 else along
        lane = shape[3]
        number = np.floor((abs(left) - shape[5]) / lane)
        across = (abs(left) - shape[5]) - (number + 0.5) * lane
        inner, outer = number == 0, number == shape[4] - 1
        turn_right = outer and same
        turns = -1 if turn_right else (1 if inner and not same else 0)
        for tail in (mouth + 16.0, mouth + 34.0):
            if _arrow(tail - before, -across, turns):
                return 2
    return 0


@leaf
def _at_crossing(
    s: float, left: float, edge: float, junction: int, crossings: NDArray[np.float64], half: float, median: float,
    c: int,
) -> int:  # fmt: skip
    """Return 1 on the paint of a zebra crossing, of its stop line and of the line before it, 0 between, -1 away."""
    if c < 0:
        return -1
    a, ahead = abs(left), crossings[c, 0] > s
    gap = abs(s - crossings[c, 0]) - crossings[c, 1]
    if gap < 0:
        on_road = median < a < half - 0.3
        return 1 if on_road and (left % 1.0) < 0.5 else 0
    if gap < 12.0 and junction == 0:
        before = gap if ahead == (left < 0) else -gap
        if (a < _LINE and median == 0) or (1.2 < before < 1.6 and median + 0.3 < a and edge < -0.3):
            return 1
    return -1


@leaf
def _between_lanes(s: float, a: float, edge: float, shape: NDArray[np.float64]) -> bool:
    """Return whether a place is on the centre line, on a line between lanes or on that along the median."""
    lane, lanes, median = shape[3], shape[4], shape[5]
    if median == 0 and a < _LINE:
        return bool(lanes > 1 or (s % 9.0) < 3.0)
    if median > 0 and abs(a - median - 0.3) < _LINE:
        return True
    beside = (a - median) / lane
    if edge >= -lane / 2 or beside <= 0.5 or abs(beside - np.rint(beside)) * lane >= _LINE:
        return False
    return bool((s % 9.0) < 3.0)


@leaf
def _at_the_edge(
    s: float, left: float, edge: float, section: NDArray[np.float64], shape: NDArray[np.float64],
    arms: NDArray[np.float64], crossings: NDArray[np.float64], near: Nearby,
) -> bool:  # fmt: skip
    """Return whether a place is on the edge line or on the lines of parking bays."""
    side = 0 if left >= 0 else 1
    if section[side, 1] == 0 or edge < -_LINE:
        return section[side, 1] == 0 and abs(edge + 0.45) < _LINE
    if not bay_is_free(s, side, section, arms, crossings, near):
        return False
    if edge < _LINE:
        return True
    # Slanted bays are entered forwards: their far ends lie ahead in the direction of traffic.
    slant = shape[6]
    bay = (s + slant * edge * (1 if left >= 0 else -1)) % (SLANTED_BAY if slant > 0 else BAY)
    return bay < 0.1


@leaf
def main_street_marking(
    s: float, left: float, section: NDArray[np.float64], shape: NDArray[np.float64], arms: NDArray[np.float64],
    crossings: NDArray[np.float64], near: Nearby,
) -> bool:  # fmt: skip
    """Return whether a place of the main carriageway is painted.

    Arrays are those of `Ground`: compiled code is several times faster with arrays than with the whole tuple.
    """
    a, side = abs(left), 0 if left >= 0 else 1
    lane_edge = section[side, 0] - section[side, 1]
    junction = _near_junction(s, left, arms, shape, lane_edge, near.arm)
    if junction == 2:
        return True
    crossing = _at_crossing(
        s, left, a - lane_edge, junction, crossings, section[side, 0], shape[5], near.crossing
    )  # fmt: skip
    if crossing >= 0 or junction == 1:
        return crossing == 1
    return _between_lanes(s, a, a - lane_edge, shape) or _at_the_edge(
        s, left, a - lane_edge, section, shape, arms, crossings, near
    )


@leaf
def marked(
    s: float, left: float, arm: int, t: float, q: float, section: NDArray[np.float64], shape: NDArray[np.float64],
    arms: NDArray[np.float64], crossings: NDArray[np.float64], near: Nearby,
) -> bool:  # fmt: skip
    """Return whether a place of the carriageway is painted; `arm`, t and q are those of `edge_distance`."""
    side = 0 if left >= 0 else 1
    if abs(left) <= section[side, 0]:
        return main_street_marking(s, left, section, shape, arms, crossings, near)
    return arm >= 0 and _side_street(t, q, arms[arm])
