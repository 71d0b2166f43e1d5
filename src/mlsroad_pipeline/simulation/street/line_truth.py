"""True kerbs and road markings of a simulated street."""

from typing import NamedTuple

import contourpy
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.simulation.street.cover import BAY, SLANTED_BAY, marked
from mlsroad_pipeline.simulation.street.ground import (
    HALF_WIDTH,
    REACH,
    SIDE,
    ZEBRA,
    Ground,
    Nearby,
    arm_places,
    edge_distance,
    hold_line,
    nearby,
)
from mlsroad_pipeline.simulation.street.street import Street

STEP = 0.1  # Spacing of the places, metres
_ALONG, _ACROSS = 0.2, 0.1  # grid of the distance to the curb line, metres
_FOOT, _TOP = -0.02, 0.06  # places on both sides of the face, metres from the curb line
_TINY = 0.01  # metres, for directions

LANE, STOP_LINE, CROSSING, OTHER = range(4)
"""Lines along lanes and edges; stop lines; middles of zebra crossings; lines between parking bays."""

_BESIDE, _APART = 0.16, 0.4  # metres from a line to its sides, and to other paint


def true_kerbs(street: Street, *, start: float, end: float, reach: float = 45.0) -> NDArray[np.float64]:
    """Return places along the foot of all kerbs between two stations, also where they are dropped to road height."""
    along, across = np.arange(start, end, _ALONG), np.arange(-reach, reach, _ACROSS)
    distance, _ = street.ground.edge(along[None, :], across[:, None])
    lines = contourpy.contour_generator(along, across, distance).lines(0.0)
    places = [_resampled(np.asarray(line, dtype=np.float64)) for line in lines]
    parts = [_described(street, line) for line in places if len(line)]
    return np.concatenate(parts) if parts else np.zeros((0, 4))


def _resampled(line: NDArray[np.float64]) -> NDArray[np.float64]:
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(STEP / 2, way[-1], STEP)
    return np.column_stack([np.interp(at, way, line[:, k]) for k in range(2)])


def _described(street: Street, line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places and heights; the kerb rises in the direction in which the distance to its line grows."""
    ground, (s, left) = street.ground, line.T
    along, across = ((ground.edge(s + a, left + b)[0] - ground.edge(s - a, left - b)[0])
                     for a, b in ((_TINY, 0.0), (0.0, _TINY)))  # fmt: skip
    rise = np.column_stack([along, across])
    rise /= np.maximum(np.hypot(*rise.T), 1e-9)[:, None]
    foot = ground.height(*(line + _FOOT * rise).T)
    height = ground.height(*(line + _TOP * rise).T) - foot
    return np.column_stack([street.alignment.place(s, left)[0], foot, height])


class TrueMarkings(NamedTuple):
    """Places on the markings of a street, relative to the survey's origin."""

    # Places every `STEP` along the middle of the painted part of lines, metres; across the bars of a crossing
    places: NDArray[np.float64]
    kind: NDArray[np.int64]  # `LANE`, `STOP_LINE`, `CROSSING` or `OTHER`
    # Places on other paint: bars of crossings, arrows, teeth of give-way lines, one for each `STEP` square
    rest: NDArray[np.float64]


def true_markings(street: Street, *, start: float, end: float) -> TrueMarkings:
    """Return places along the markings between two stations."""
    ground = street.ground
    along = np.arange(start, end, STEP)
    lines = [*_lanes(ground, along), *_bays(ground, along), *_crossings(ground, start, end), *_side_streets(ground)]
    kinds = np.concatenate([np.full(len(line), kind) for kind, line in lines])
    places = np.concatenate([line for _, line in lines])
    inside = (places[:, 0] >= start) & (places[:, 0] < end)
    places, kinds = places[inside], kinds[inside]
    across = np.arange(-REACH, REACH, STEP)
    rest = np.stack(np.meshgrid(along, across, indexing="ij"), axis=-1).reshape(-1, 2)
    rest = rest[_painted(rest, ground)]
    if len(places) and len(rest):
        rest = rest[cKDTree(places).query(rest)[0] > _APART]
    return TrueMarkings(_solid(street, places), kinds, _solid(street, rest))


def _solid(street: Street, flat: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(flat) == 0:
        return np.zeros((0, 3))
    s, left = flat.T
    return np.column_stack([street.alignment.place(s, left)[0], street.ground.height(s, left)])


def _thin(line: NDArray[np.float64], across: NDArray[np.float64], ground: Ground) -> NDArray[np.float64]:
    """Return the painted places of a line that are not inside wider paint."""
    beside = [_painted(line + side * _BESIDE * across, ground) for side in (-1, 1)]
    return line[_painted(line, ground) & ~(beside[0] & beside[1])]


def _lanes(ground: Ground, along: NDArray[np.float64]) -> list[tuple[int, NDArray[np.float64]]]:
    _, _, _, lane, lanes, median, _, _ = ground.shape
    lines = []
    for sign, section in ((1, ground.section[0]), (-1, ground.section[1])):
        edge = section[0] - section[1]
        lefts = [median + 0.3] if median > 0 else ([0.0] if sign > 0 else [])
        lefts += [median + k * lane for k in range(1, round(lanes)) if median + (k + 0.5) * lane < edge]
        lefts.append(edge if section[1] > 0 else edge - 0.45)
        for left in lefts:
            line = np.column_stack([along, np.full(len(along), sign * left)])
            gaps = np.abs(along[:, None] - ground.crossings[:, 0]) < ground.crossings[:, 1]
            lines.append((LANE, _thin(line[~gaps.any(axis=1)], np.array([0.0, 1.0]), ground)))
    return lines


def _bays(ground: Ground, along: NDArray[np.float64]) -> list[tuple[int, NDArray[np.float64]]]:
    lines = []
    slant = ground.shape[6]
    pitch = SLANTED_BAY if slant > 0 else BAY
    for sign, section in ((1, ground.section[0]), (-1, ground.section[1])):
        depth = np.arange(0.2, section[1], STEP)
        for first in np.arange(np.floor(along[0] / pitch), np.ceil(along[-1] / pitch) + 1) * pitch + 0.05:
            line = np.column_stack([first - slant * depth * sign, sign * (section[0] - section[1] + depth)])
            lines.append((OTHER, _thin(line, np.array([1.0, 0.0]), ground)))
    return lines


def _crossings(ground: Ground, start: float, end: float) -> list[tuple[int, NDArray[np.float64]]]:
    lines = []
    median = ground.shape[5]
    for at, half in ground.crossings:
        for sign, section in ((1, ground.section[0]), (-1, ground.section[1])):
            left = sign * np.arange(median + STEP / 2, section[0] - 0.3, STEP)
            lines.append((CROSSING, np.column_stack([np.full(len(left), at), left])))
            # Traffic on the left runs back, so its stop line is behind.
            stop = np.column_stack([np.full(len(left), at + sign * (half + 1.4)), left])
            stop = stop[_painted(stop, ground) & (np.abs(left) > median + 0.3)]
            lines.append((STOP_LINE, stop))
    return [(kind, line) for kind, line in lines if len(line) == 0 or start <= line[0, 0] < end]


def _side_streets(ground: Ground) -> list[tuple[int, NDArray[np.float64]]]:
    lines = []
    for arm in ground.arms:
        half, zebra, main = arm[HALF_WIDTH], arm[ZEBRA], ground.section[int(arm[SIDE]), 0]
        hold = hold_line(arm)
        t = np.arange(hold, REACH - ground.section.max(), STEP)
        middle = arm_places(arm, main, t, 0.0)
        lines.append((LANE, middle[_painted(middle, ground)]))
        q = np.arange(-half + STEP / 2, half, STEP)
        stop = arm_places(arm, main, hold + 0.2, q)
        lines.append((STOP_LINE, stop[_painted(stop, ground) & (np.abs(q) > 0.2)]))
        if zebra > 0:
            inside = q[np.abs(q) < half - 0.25]
            lines.append((CROSSING, arm_places(arm, main, zebra, inside)))
    return lines


def _painted(places: NDArray[np.float64], ground: Ground) -> NDArray[np.bool_]:
    return _marked(np.ascontiguousarray(places[:, 0]), np.ascontiguousarray(places[:, 1]), ground)


@njit(cache=True, nogil=True)
def _marked(s: NDArray[np.float64], left: NDArray[np.float64], ground: Ground) -> NDArray[np.bool_]:
    found, rows = np.zeros(len(s), dtype=np.bool_), Nearby(0, 0, 0)
    for i in range(len(s)):
        rows = nearby(s[i], ground, rows)
        d, arm, t, q = edge_distance(s[i], left[i], ground, rows.arm)
        if d <= 0:
            found[i] = marked(s[i], left[i], arm, t, q, ground, rows)
    return found
