"""Lines of two surveys: the lengths that are unchanged, new, gone, or not visible in one of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.changes.objects import GONE, NEW, UNCHANGED, UNSEEN_FIRST, UNSEEN_SECOND

STEP = 0.5
"""Distance of the places along a line that are compared, metres."""
REACH = {"kerb": 0.5, "wire": 1.0, "barrier": 0.5}
MARKING_REACH = 0.4
"""Largest distance of places of the same line in two surveys, metres."""
LEAST_LENGTH = 2.0
"""Length of the shortest part of a line with a state of its own, metres."""
ASIDE, ALONG = 0.6, 0.5
"""Reach of the points that show a line, across and along, metres."""
FEWEST = 5
"""Fewest points on each side of a line, and on a marking, that show it or prove that it is not there."""
STILL_THERE = 0.5
"""Share of the step or contrast of a line in one survey from which the other survey shows it too."""
WIRE_NEAR, OTHER_WIRE = 0.3, 5.0
"""Distance of points that show a wire, and distance of another wire that proves that wires were seen there, metres."""
BARRIER_NEAR = 0.3
"""Distance in plan of points that show a barrier, metres."""
STATES = (UNCHANGED, NEW, GONE, UNSEEN_FIRST, UNSEEN_SECOND)
"""States of parts of lines."""
SHIFTS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Offsets across at which a marking is searched for, metres."""
LEAST_STEP, LEAST_CONTRAST = 0.04, 0.3
"""Least step of a kerb, metres, and least contrast of a marking in the points of its own survey."""
SHOWN, ABSENT, UNSEEN = "shown", "absent", "unseen"
"""States of a part of a line by the points of the other survey."""


class LinePart(NamedTuple):
    """Part of a line with one state."""

    kind: str
    state: str  # Empty: not known yet
    first: int  # Row of the line in the earlier survey, -1: none
    second: int
    places: NDArray[np.float64]  # Along it, shape (n, 3)
    reason: str


class Lines(NamedTuple):
    """Lines of a survey: kinds and vertices."""

    kind: Sequence[str]
    vertices: Sequence[NDArray[np.float64]]


def places_on(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places along a line, at most `STEP` apart, with both ends."""
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(vertices[:, :2], axis=0).T)))
    at = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / STEP)) + 1))
    return np.column_stack([np.interp(at, way, axis) for axis in vertices.T])


def length_of(places: NDArray[np.float64]) -> float:
    """Return the length of a line in plan, metres."""
    return float(np.hypot(*np.diff(places[:, :2], axis=0).T).sum())


def compare_lines(first: Lines, second: Lines) -> list[LinePart]:
    """Return the parts of the lines of two surveys.

    A part near a line of its kind (a marking: of any) in the other survey is unchanged, once: with the places of the
    later survey. Other parts have no state yet.
    """
    parts = []
    for own, other, later in ((second, first, True), (first, second, False)):
        trees = {kind: _places_of(other, _group(kind)) for kind in set(own.kind)}
        for row, (kind, vertices) in enumerate(zip(own.kind, own.vertices, strict=True)):
            places, (tree, lines) = places_on(vertices), trees[kind]
            near = np.zeros(len(places), dtype=np.bool_)
            if tree is not None:
                distance, place = tree.query(places[:, :2], distance_upper_bound=REACH.get(kind, MARKING_REACH))
                near = np.isfinite(distance)
            for start, stop in _runs(near, length_of(places) / max(1, len(places) - 1)):
                ends = (-1, row) if later else (row, -1)
                if not near[start:stop].mean() > 0.5:
                    parts.append(LinePart(kind, "", *ends, places[start:stop], ""))
                elif later:
                    partner = int(np.bincount(lines[place[start:stop][near[start:stop]]]).argmax())
                    parts.append(LinePart(kind, UNCHANGED, partner, row, places[start:stop], "listed in both"))
    return parts


def _group(kind: str) -> str:
    """Return the kind of a line; markings of all kinds are one, because they are taken for each other."""
    return kind if kind in REACH else "marking"


def _places_of(lines: Lines, kind: str) -> tuple[cKDTree | None, NDArray[np.int64]]:
    rows = [row for row, name in enumerate(lines.kind) if _group(name) == kind]
    places = [places_on(lines.vertices[row])[:, :2] for row in rows]
    owner = np.repeat(np.array(rows, dtype=np.int64), [len(own) for own in places])
    return (cKDTree(np.concatenate(places)) if rows else None), owner


def _runs(near: NDArray[np.bool_], step: float) -> list[tuple[int, int]]:
    """Return the ranges of equal values; those shorter than `LEAST_LENGTH` belong to their neighbours."""
    near, least = near.copy(), max(1, int(np.ceil(LEAST_LENGTH / max(step, 1e-6))))
    while True:
        edges = np.flatnonzero(np.diff(near)) + 1
        starts, stops = np.append(0, edges), np.append(edges, len(near))
        short = np.flatnonzero(stops - starts < least)
        if len(starts) == 1 or not len(short):
            # Neighbouring parts share the place between them.
            return [(int(a), int(min(b + 1, len(near)))) for a, b in zip(starts, stops, strict=True)]
        run = short[(stops - starts)[short].argmin()]
        near[starts[run] : stops[run]] = ~near[starts[run]]


def with_evidence(part: LinePart, found: str) -> LinePart:
    """Return a part of a line of one survey with its state; `found` is what the points of the other survey say."""
    later = part.first < 0
    other = "first" if later else "second"
    state = {SHOWN: UNCHANGED, ABSENT: NEW if later else GONE, UNSEEN: UNSEEN_FIRST if later else UNSEEN_SECOND}[found]
    reason = {
        SHOWN: f"not listed, but shown by the points of the {other} survey",
        ABSENT: f"the {other} survey saw its place without it",
        UNSEEN: f"the points of the {other} survey prove nothing there",
    }
    return part._replace(state=state, reason=reason[found])


def step_across(points: NDArray[np.float64], places: NDArray[np.float64]) -> float:
    """Return the difference in height of the ground on both sides of a line, metres; NaN: too few points."""
    aside = offsets_from(points, places)
    sides = [points[(side * aside > 0.12) & (side * aside < ASIDE), 2] for side in (1, -1)]
    if min(map(len, sides)) < FEWEST:
        return np.nan
    return float(np.median(sides[0]) - np.median(sides[1]))


def contrast_of(
    points: NDArray[np.float64], intensity: NDArray[np.floating], places: NDArray[np.float64], width: float
) -> float:
    """Return the intensity on a marking relative to the road beside it, minus 1; NaN: too few points.

    The marking may lie up to 0.2 m aside of the places: the largest contrast counts.
    """
    offset, found = offsets_from(points, places), []
    for shift in SHIFTS:
        aside = np.abs(offset - shift)
        on = intensity[aside < max(0.05, width / 2 - 0.02)]
        beside = intensity[(aside > width / 2 + 0.1) & (aside < ASIDE)]
        if min(len(on), len(beside)) >= FEWEST and np.mean(beside) > 0:
            found.append(float(np.mean(on) / np.mean(beside) - 1))
    return max(found, default=np.nan)


def barrier_seen(points: NDArray[np.float64], is_ground: NDArray[np.bool_], places: NDArray[np.float64]) -> str:
    """Return what points say of a barrier: those above the ground show it, ground alone disproves it."""
    aside = offsets_from(points, places)
    sides = [(is_ground & (side * aside > 0.0) & (side * aside < ASIDE)).sum() for side in (1, -1)]
    upright = points[~is_ground & (np.abs(aside) < BARRIER_NEAR)]
    if len(upright):
        met = np.isfinite(cKDTree(upright[:, :2]).query(places[:, :2], distance_upper_bound=ALONG)[0]).mean()
        if met > STILL_THERE:
            return SHOWN
    return ABSENT if min(sides) >= FEWEST * len(places) else UNSEEN


def same_measure(own: float, other: float, least: float) -> str:
    """Return what a step or contrast in the other survey says about the line of this one.

    A line whose own points do not show at least `least` proves nothing.
    """
    if not (np.isfinite(own) and np.isfinite(other)) or abs(own) < least:
        return UNSEEN
    return SHOWN if other * np.sign(own) >= STILL_THERE * abs(own) else ABSENT


def offsets_from(points: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances of points from a line in plan, positive on its left; infinite beyond `ALONG` of a place."""
    way = np.gradient(places[:, :2], axis=0)
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    distance, near = cKDTree(places[:, :2]).query(points[:, :2], distance_upper_bound=ASIDE + ALONG)
    known = np.isfinite(distance)
    offset = np.full(len(points), np.inf)
    apart = points[known, :2] - places[near[known], :2]
    offset[known] = way[near[known], 0] * apart[:, 1] - way[near[known], 1] * apart[:, 0]
    return offset
