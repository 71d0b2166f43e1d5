"""Kinds of markings: crossings, stop lines, lane lines, others; dashes; lines inside the carriageway."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.lines.markings.tracing import line_length
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


def beyond_kerb(
    places: NDArray[np.float64], kerbs: Sequence[NDArray[np.float64]], trajectory: Trajectory
) -> NDArray[np.bool_]:
    """Return which places are higher up than the path by one kerb or more.

    Kerbs between a place and the nearest position of the path are counted, upward ones less downward ones: the second
    carriageway behind a median is on the level of the first.
    """
    if len(places) == 0 or not kerbs:
        return np.zeros(len(places), dtype=bool)
    station = np.clip(trajectory.locate(places)[0], 0.0, trajectory.length)
    origin = places[0, :2]
    start = np.column_stack([np.interp(station, trajectory.station, trajectory.xyz[:, k]) for k in range(2)]) - origin
    way = places[:, :2] - origin - start
    first, last = (np.concatenate([line[part, :2] for line in kerbs]) - origin for part in (slice(-1), slice(1, None)))
    along = last - first
    up = np.zeros(len(places), dtype=np.int64)
    for k in range(len(places)):
        turn = along[:, 0] * way[k, 1] - along[:, 1] * way[k, 0]
        apart = first - start[k]
        with np.errstate(divide="ignore", invalid="ignore"):  # parallel ones do not meet
            share = (apart[:, 1] * along[:, 0] - apart[:, 0] * along[:, 1]) / turn
            part = (apart[:, 1] * way[k, 0] - apart[:, 0] * way[k, 1]) / turn
        meets = (share > 0) & (share < 1) & (part >= 0) & (part < 1)
        up[k] = int(np.sign(turn[meets]).sum())
    return up > 0


LANE_LINE, STOP_LINE, CROSSING, OTHER = "lane_line", "stop_line", "crossing", "other_marking"
"""Kinds of markings."""

SOLID, DASHED = "solid", "dashed"
"""Patterns of lane lines."""

LEAST_SCORE, LEAST_BEYOND = 0.35, 0.75
"""Least score of a listed marking, and of one beyond a kerb: pavements and yards have bright stripes, too."""

# Logistic regression of `_measures` on the 994 lines traced on eight simulated streets of 100 m (seeds 911 to 918), but
# for the weight of the contrast, 0.04 there, and the constant: lines of little contrast are borders of surfaces.
_WEIGHTS, _CONSTANT = np.array([1.74, 1.2, -0.27, 0.44, 0.18]), -3.78
_BAR_WIDTH, _BAR_LENGTH, _BARS = 0.2, (1.2, 7.0), 3  # least width, bounds of the length, metres; least number
_BAR_GAP, _BAR_SHIFT, _PARALLEL = (0.3, 2.2), 0.4, 0.96  # metres across; share of the length; cosine
_STOP_WIDTH, _STOP_LENGTH = 0.27, (1.5, 14.0)  # metres
_ACROSS, _NEAR_PATH, _NEAR_LINE = 0.5, 12.0, 3.0  # cosine; metres
_DASH, _DASH_GAP, _DASH_OFF, _DASH_WAY = 7.0, (0.6, 13.0), 0.35, 0.98  # metres; cosine
_CONTINUED = 20.0  # metres: lines of the same direction, ahead or beside
_DASH_RATIO = 2.5  # of the lengths of a dash and the next one
_LONG = 6.0  # metres: longer ones are lane lines, whatever their direction
_CROWD, _BESIDE = 3, 2.0  # least number of other short lines, largest distance of their middles, metres


@dataclass
class Marking:
    """A marking."""

    vertices: NDArray[np.float64]  # The middle line, world coordinates, metres
    width: float  # Width of a line; of a crossing the length of its bars, metres
    contrast: float  # Median difference to the road on both sides, standard deviations
    score: float  # Probability that it is a marking
    kind: str = OTHER  # One of the kinds
    pattern: str = ""  # `SOLID` or `DASHED` for lane lines, empty for others

    @property
    def length(self) -> float:
        """Length in plan, metres."""
        return line_length(self.vertices)

    @property
    def middle(self) -> NDArray[np.float64]:
        """Middle between the ends, metres."""
        return np.asarray((self.vertices[0, :2] + self.vertices[-1, :2]) / 2)

    @property
    def along(self) -> NDArray[np.float64]:
        """Unit vector from end to end."""
        chord = self.vertices[-1, :2] - self.vertices[0, :2]
        return np.asarray(chord / max(np.hypot(*chord), 1e-9))


def markings_of(
    lines: list[NDArray[np.float64]], trajectory: Trajectory | None, kerbs: Sequence[NDArray[np.float64]] = ()
) -> list[Marking]:
    """Return the markings that traced lines are."""
    medians = (np.median(line[:, 3:5], axis=0).tolist() for line in lines)
    traced = [Marking(line[:, :3], width, by, 0.0) for line, (width, by) in zip(lines, medians, strict=True)]
    for marking, score in zip(traced, _scores(traced), strict=True):
        marking.score = score
    crossings, rest = (_likely(part, trajectory, kerbs) for part in _crossings(traced))
    dashes, crowded = _dashes(rest), _crowded(rest, traced)
    at_lane = _Ends(rest)
    for marking, dash, crowd, (turned, far) in zip(rest, dashes, crowded, _to_path(rest, trajectory), strict=True):
        marking.kind = _kind(marking, at_lane, dash=dash, crowd=crowd, turned=turned, far=far)
        if marking.kind == LANE_LINE:
            marking.pattern = DASHED if dash else SOLID
    return [*crossings, *rest]


def _likely(
    markings: list[Marking], trajectory: Trajectory | None, kerbs: Sequence[NDArray[np.float64]]
) -> list[Marking]:
    """Return the markings whose score is high enough for their place."""
    least = np.full(len(markings), LEAST_SCORE)
    if trajectory is not None and markings:
        middles = np.array(
            [m.vertices[[(len(m.vertices) - 1) // 2, len(m.vertices) // 2]].mean(axis=0) for m in markings]
        )
        least[beyond_kerb(middles, kerbs, trajectory)] = LEAST_BEYOND
    return [marking for marking, score in zip(markings, least, strict=True) if marking.score >= score]


def _scores(markings: list[Marking]) -> list[float]:
    """Return the probabilities that lines are markings, by their measures."""
    return (1.0 / (1.0 + np.exp(-(_measures(markings) @ _WEIGHTS + _CONSTANT)))).tolist() if markings else []


def _measures(markings: list[Marking]) -> NDArray[np.float64]:
    """Return length, contrast, width, and the lengths of the lines that continue each line and that run beside it."""
    middle, along = (np.array([getattr(m, name) for m in markings]) for name in ("middle", "along"))
    length = np.array([m.length for m in markings])
    tree, same_way = cKDTree(middle), np.zeros((len(markings), 2))
    for k, near in enumerate(tree.query_ball_point(middle, _CONTINUED)):
        others = np.array(near, dtype=np.int64)
        others = others[(others != k) & (np.abs(along[others] @ along[k]) > _DASH_WAY)]
        apart = middle[others] - middle[k]
        distance = np.hypot(*apart.T)
        across, way = np.abs(apart @ (along[k, 1], -along[k, 0])), np.abs(apart @ along[k])
        ahead = (across < _DASH_OFF + 0.03 * distance) & (way > length[k] / 2)
        same_way[k] = length[others[ahead]].sum(), length[others[~ahead]].sum()
    own = np.log([[max(m.length, 1e-3), m.contrast] for m in markings])
    return np.column_stack([own, [m.width for m in markings], np.log1p(same_way)])


def _crossings(markings: list[Marking]) -> tuple[list[Marking], list[Marking]]:
    """Return crossings of at least three parallel bars side by side, and the markings that are no bars."""
    low, high = _BAR_LENGTH
    bars = [k for k, m in enumerate(markings) if m.width >= _BAR_WIDTH and low <= m.length <= high]
    if len(bars) < _BARS:
        return [], markings
    near = np.hypot(_BAR_GAP[1], _BAR_SHIFT * high + 0.3)
    tree = cKDTree(np.array([markings[k].middle for k in bars]))
    pairs = [(a, b) for b, a in sorted(tree.query_pairs(near)) if _beside(markings[bars[a]], markings[bars[b]])]
    if not pairs:
        return [], markings
    rows, columns = np.array(pairs).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(bars), len(bars)))
    group = connected_components(graph, directed=False)[1]
    crossings, used = [], set()
    for number in np.flatnonzero(np.bincount(group) >= _BARS):
        own = [bars[k] for k in np.flatnonzero(group == number)]
        crossings.append(_crossing([markings[k] for k in own]))
        used.update(own)
    return crossings, [m for k, m in enumerate(markings) if k not in used]


def _beside(a: Marking, b: Marking) -> bool:
    apart = a.middle - b.middle
    along = b.along
    across = abs(apart[0] * along[1] - apart[1] * along[0])
    shift = abs(float(apart @ along))
    level = _BAR_GAP[0] < across < _BAR_GAP[1] and shift < _BAR_SHIFT * max(a.length, b.length) + 0.3
    return bool(level and abs(float(a.along @ along)) > _PARALLEL)


def _crossing(bars: list[Marking]) -> Marking:
    """Return the line across the middles of bars, half a bar beyond the outer ones, as wide as the bars are long."""
    middles = np.array([(bar.vertices[0] + bar.vertices[-1]) / 2 for bar in bars])
    centre = middles.mean(axis=0)
    along = np.linalg.svd(middles[:, :2] - centre[:2], full_matrices=False)[2][0]
    way = (middles[:, :2] - centre[:2]) @ along
    half = float(np.median([bar.width for bar in bars])) / 2
    ends = np.array([way.min() - half, way.max() + half])
    slope = np.polyfit(way, middles[:, 2] - centre[2], 1)
    vertices = np.column_stack([centre[:2] + ends[:, None] * along, centre[2] + np.polyval(slope, ends)])
    width = float(np.median([bar.length for bar in bars]))
    contrast = float(np.median([bar.contrast for bar in bars]))
    return Marking(vertices, width, contrast, max(bar.score for bar in bars), CROSSING)


def _dashes(markings: list[Marking]) -> NDArray[np.bool_]:
    """Return which short lines are continued by another short one beyond a gap."""
    length = np.array([marking.length for marking in markings])
    found = np.zeros(len(markings), dtype=bool)
    short = np.flatnonzero(length <= _DASH * _DASH_RATIO)
    if len(short) < 2:
        return found
    length = length[short]
    middle, along = (np.array([getattr(markings[k], name) for k in short]) for name in ("middle", "along"))
    tree = cKDTree(middle)
    for k in np.flatnonzero(length <= _DASH):
        near = _DASH_GAP[1] + length[k] * (1 + _DASH_RATIO) / 2
        others = np.array(tree.query_ball_point(middle[k], near), dtype=np.int64)
        apart = middle[others] - middle[k]
        distance = np.hypot(*apart.T)
        gap = distance - (length[k] + length[others]) / 2
        across = np.abs(apart @ (along[k, 1], -along[k, 0]))
        alike = np.maximum(length[others], length[k]) <= _DASH_RATIO * np.minimum(length[others], length[k])
        same = np.abs(along[others] @ along[k]) > _DASH_WAY
        ahead = (gap > _DASH_GAP[0]) & (gap < _DASH_GAP[1]) & (across < _DASH_OFF + 0.03 * distance)
        found[short[k]] = (alike & same & ahead).any()
    return found


def _crowded(markings: list[Marking], traced: list[Marking]) -> NDArray[np.bool_]:
    """Return which short lines have several others beside them, as pieces of a crossing between wide scan lines."""
    middles = np.array([line.middle for line in traced if line.length <= _LONG]).reshape(-1, 2)
    if not len(middles) or not markings:
        return np.zeros(len(markings), dtype=bool)
    near = cKDTree(middles).query_ball_point([marking.middle for marking in markings], _BESIDE, return_length=True)
    short = np.array([marking.length <= _LONG for marking in markings])
    return np.asarray(short & (near > _CROWD))


def _kind(marking: Marking, ends: _Ends, *, dash: bool, crowd: bool, turned: float, far: float) -> str:
    near, (low, high) = far < _NEAR_PATH, _STOP_LENGTH
    may_stop = marking.width >= _STOP_WIDTH and low <= marking.length <= high
    if may_stop and (turned < _ACROSS if near else ends.meet(marking)):
        return STOP_LINE
    is_lane = turned > np.sqrt(1 - _ACROSS**2) or dash or marking.length >= _LONG
    return LANE_LINE if is_lane and not crowd else OTHER


def _to_path(markings: list[Marking], trajectory: Trajectory | None) -> list[tuple[float, float]]:
    """Return the cosine to the path beside each line and the distance from it; without a path 0 and infinity."""
    if trajectory is None or not markings:
        return [(0.0, np.inf)] * len(markings)
    station, offset = trajectory.locate(np.array([[*marking.middle, 0.0] for marking in markings]))
    at = np.clip(station[:, None] + np.array([-2.0, 2.0]), 0.0, trajectory.length)
    first, last = (
        np.column_stack([np.interp(of, trajectory.station, trajectory.xyz[:, k]) for k in range(2)]) for of in at.T
    )
    way = last - first
    along = np.array([marking.along for marking in markings])
    turned = np.abs((along * way).sum(axis=1)) / np.maximum(np.hypot(*way.T), 1e-9)
    return list(zip(turned.tolist(), np.abs(offset).tolist(), strict=True))


class _Ends:
    """Ends of narrow lines, at which wide ones are stop lines of side streets."""

    def __init__(self, markings: list[Marking]) -> None:
        lines = [m for m in markings if m.width < _STOP_WIDTH and m.length > 2.0]
        self.along = np.array([m.along for m in lines for _ in range(2)])
        self.tree = cKDTree(np.array([m.vertices[end, :2] for m in lines for end in (0, -1)])) if lines else None

    def meet(self, marking: Marking) -> bool:
        """Return whether a narrow line of another direction begins at a wide one."""
        if self.tree is None:
            return False
        near = self.tree.query_ball_point(marking.vertices[:, :2], _NEAR_LINE)
        rows = sorted({row for rows in near for row in rows})
        return bool((np.abs(self.along[rows] @ marking.along) < _ACROSS).any())
