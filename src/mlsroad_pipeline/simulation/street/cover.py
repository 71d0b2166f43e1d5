"""Ground cover at a place: road markings, class, brightness, and height above the mesh of the ground."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf
from mlsroad_pipeline.simulation.model.materials import lattice_value, plane_noise
from mlsroad_pipeline.simulation.street.alignment import STEP
from mlsroad_pipeline.simulation.street.ground import (
    CONTROL,
    CURB,
    GIVE_WAY,
    GRASS,
    GUTTER,
    HALF_WIDTH,
    LANE_MARKING,
    LID,
    MANHOLE,
    PARKING,
    RADIUS,
    REACH,
    ROAD,
    SIDE,
    SIDEWALK,
    SIGNALS,
    SOIL,
    STATION,
    ZEBRA,
    ZEBRA_HALF,
    Ground,
    Nearby,
    bay_is_free,
    edge_distance,
    hold_line,
)

BAY = 5.8  # Length of a parallel parking bay, metres
SLANTED_BAY = 2.9  # Length along the curb of a slanted one, metres
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
    hold = hold_line(row)
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
def _at_the_edge(s: float, left: float, edge: float, ground: Ground, near: Nearby) -> bool:
    """Return whether a place is on the edge line or on the lines of parking bays."""
    side = 0 if left >= 0 else 1
    if ground.section[side, 1] == 0 or edge < -_LINE:
        return ground.section[side, 1] == 0 and abs(edge + 0.45) < _LINE
    if not bay_is_free(s, side, ground, near):
        return False
    if edge < _LINE:
        return True
    # Slanted bays are entered forwards: their far ends lie ahead in the direction of traffic.
    slant = ground.shape[6]
    bay = (s + slant * edge * (1 if left >= 0 else -1)) % (SLANTED_BAY if slant > 0 else BAY)
    return bay < 0.1


@leaf
def main_street_marking(s: float, left: float, ground: Ground, near: Nearby) -> bool:
    """Return whether a place of the main carriageway is painted."""
    shape, side = ground.shape, 0 if left >= 0 else 1
    a, half = abs(left), ground.section[side, 0]
    lane_edge = half - ground.section[side, 1]
    junction = _near_junction(s, left, ground.arms, shape, lane_edge, near.arm)
    if junction == 2:
        return True
    crossing = _at_crossing(s, left, a - lane_edge, junction, ground.crossings, half, shape[5], near.crossing)
    if crossing >= 0 or junction == 1:
        return crossing == 1
    return _between_lanes(s, a, a - lane_edge, shape) or _at_the_edge(s, left, a - lane_edge, ground, near)


@leaf
def marked(s: float, left: float, arm: int, t: float, q: float, ground: Ground, near: Nearby) -> bool:
    """Return whether a place of the carriageway is painted; `arm`, t and q are those of `edge_distance`."""
    if abs(left) <= ground.section[0 if left >= 0 else 1, 0]:
        return main_street_marking(s, left, ground, near)
    return arm >= 0 and _side_street(t, q, ground.arms[arm])


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
def _on_carriageway(s: float, left: float, arm: int, t: float, q: float, ground: Ground, near: Nearby) -> int:
    if _lid(s, left, ground.manholes, near.hole):
        return MANHOLE
    if marked(s, left, arm, t, q, ground, near):
        return LANE_MARKING
    side = 0 if left >= 0 else 1
    half, parking = ground.section[side, 0], ground.section[side, 1]
    bay = half - parking < abs(left) <= half and bay_is_free(s, side, ground, near)
    return PARKING if bay else ROAD


@leaf
def _off_carriageway(s: float, left: float, d: float, arm: int, t: float, ground: Ground, near: Nearby) -> int:
    side = 0 if left >= 0 else 1
    a, arms, crossings, verge = abs(left), ground.arms, ground.crossings, ground.verge
    curb, strip, pavement = ground.section[side, 2], ground.section[side, 3], ground.section[side, 4]
    # Edges of grass and soil are ragged.
    row = int(min(max((s + 0.3 * lattice_value(int(a * 8), int(s * 8), 3) - ground.start) / STEP, 0.0),
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
        return int(ground.lot[side, row])
    if not paved and (arm == -2 or d <= curb + strip):
        return int(planted)
    return SIDEWALK


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
def ground_cover(s: float, left: float, ground: Ground, near: Nearby) -> tuple[int, float, float]:
    """Return label, brightness factor (about 1) and relief (metres above the ground's mesh) of the cover at one place.

    `near` are the rows where the search begins.
    """
    d, arm, t, q = edge_distance(s, left, ground, near.arm)
    if d <= 0:
        label = _on_carriageway(s, left, arm, t, q, ground, near)
    elif d <= ground.section[0 if left >= 0 else 1, 2]:
        label = CURB
    else:
        label = _off_carriageway(s, left, d, arm, t, ground, near)
    tone = surface_tone(label, s, left)
    if -GUTTER < d <= 0 and label in (ROAD, PARKING):  # a row of gutter stones
        joint = 0.8 if (s % 0.5) < 0.012 or d > -0.012 else 1.0
        tone *= 1.45 * joint
    if label == MANHOLE and (s % 0.06) < 0.02:
        tone *= 0.6
    return label, tone, _relief(label, s, left, tone, ground.shape[7])
