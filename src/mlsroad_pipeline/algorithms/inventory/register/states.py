"""States of the entries of a register: confirmed, moved, of another kind, gone, not visible; objects that are new."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.register.seen_space import CELL, HALF, LOW, SIDE, SLICE, SLICES, SeenSpace

CONFIRMED, MOVED, OTHER_KIND = "confirmed", "moved", "different kind"
NOT_FOUND, NOT_VISIBLE, NEW = "not found", "not visible", "new"
STATES = (CONFIRMED, MOVED, OTHER_KIND, NOT_FOUND, NOT_VISIBLE, NEW)
"""States of entries; the last is that of objects without an entry."""
BY_OBJECT, BY_POINTS, BY_OTHERS, BY_RAYS = "object", "points", "points of other classes", "rays"
"""Evidence of a state."""

REACH = {"pole": 1.0, "sign": 1.0, "tree": 1.5}
"""Largest distance in plan of an entry and the object that confirms it, metres."""
MOVED_REACH = 5.0
"""Largest distance of an entry that moved, metres."""
SAME_HEIGHT = 0.8
"""Least ratio of the heights of an entry and its object, where these are first choice."""
OTHER_HEIGHT = 0.5
"""Least ratio of the heights of an entry and an object of another kind at its place."""
RADIUS = {"pole": 0.5, "sign": 0.5, "tree": 0.7}
"""Radius around the place of an entry in which it is searched for, metres."""
TOP = 3.0
"""Height up to which a shaft or trunk is searched for, metres."""
LEAST_OWN = {"pole": 8, "sign": 8, "tree": 15}
"""Fewest points of its kind that confirm an entry without an object."""
LEAST_SLICES, LEAST_OTHERS = 0.3, 0.6
"""Least share of the slices with points of its kind (of signs: any), and of other upright kinds, that confirm an entry.

Poles, signs, trees and street furniture are often taken for each other, and most entries of a register are right.
"""
FEWEST_SLICES = 3
"""Fewest slices that prove that nothing stands at a place."""
FREE_SLICES = 0.25
"""Share of the slices of a column that must be free for the column to hold no shaft."""
EMPTY = 0.8
"""Share of the columns without a shaft from which nothing stands at a place."""


Allowed = Callable[[pd.DataFrame, pd.DataFrame], pd.Series]
"""Function that returns which pairs, given as two tables of equal length, may be assigned."""


class Matches(NamedTuple):
    """State of each entry so far (empty: none), row of its object or -1, and which objects have an entry."""

    state: NDArray[np.object_]
    row: NDArray[np.int64]
    used: NDArray[np.bool_]


def assigned(
    first: pd.DataFrame, second: pd.DataFrame, reach: float, allowed: Allowed
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the positions of rows that are assigned one to one, of pairs within reach in plan that are allowed."""

    def may(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.bool_]:
        pairs = (table.iloc[rows].reset_index(drop=True) for table, rows in ((first, i), (second, j)))
        return allowed(*pairs).to_numpy(dtype=np.bool_)

    places = [table[["x", "y"]].to_numpy(dtype=np.float64) for table in (first, second)]
    return assign_one_to_one(places[0], places[1], reach, may)


def same_kind(first: pd.DataFrame, second: pd.DataFrame) -> pd.Series:
    """Return which pairs are of one kind, within its `REACH`."""
    distance = np.hypot(first["x"] - second["x"], first["y"] - second["y"])
    return (first["kind"] == second["kind"]) & (distance <= first["kind"].map(REACH))


def other_kind(first: pd.DataFrame, second: pd.DataFrame) -> pd.Series:
    """Return which pairs are of different kinds and may be one object.

    Other heights: a neighbour that hides the object, such as the tree around a lamp. Unknown ones prove nothing.
    """
    return (first["kind"] != second["kind"]) & ~(height_ratio(first, second) < OTHER_HEIGHT)


def height_ratio(first: pd.DataFrame, second: pd.DataFrame) -> pd.Series:
    """Return the ratio of the lower to the larger height of pairs; NaN where one is not known."""
    ratio = first["height"].astype(np.float64) / second["height"].astype(np.float64)
    return ratio.where(ratio <= 1, 1 / ratio)


def confirm(entries: pd.DataFrame, objects: pd.DataFrame) -> Matches:
    """Match entries with objects of their kind and height within `REACH`, one to one."""
    state, row = np.full(len(entries), "", dtype=object), np.full(len(entries), -1, dtype=np.int64)
    matches = Matches(state, row, np.zeros(len(objects), dtype=np.bool_))
    _match(entries, objects, matches, CONFIRMED, max(REACH.values()), _alike, of_states=("",))
    return matches


def _match(
    entries: pd.DataFrame,
    objects: pd.DataFrame,
    matches: Matches,
    state: str,
    reach: float,
    allowed: Allowed,
    *,
    of_states: tuple[str, ...] = (NOT_FOUND, NOT_VISIBLE),
) -> None:
    """Match entries of some states with free objects, in place."""
    own, free = np.flatnonzero(np.isin(matches.state, of_states)), np.flatnonzero(~matches.used)
    a, b = assigned(entries.iloc[own], objects.iloc[free], reach, allowed)
    matches.state[own[a]], matches.row[own[a]], matches.used[free[b]] = state, free[b], True


def _alike(entries: pd.DataFrame, objects: pd.DataFrame) -> pd.Series:
    return same_kind(entries, objects) & ~(height_ratio(entries, objects) < SAME_HEIGHT)


def _alike_other(entries: pd.DataFrame, objects: pd.DataFrame) -> pd.Series:
    return (entries["kind"] != objects["kind"]) & (height_ratio(entries, objects) >= SAME_HEIGHT)


def _moved(entries: pd.DataFrame, objects: pd.DataFrame) -> pd.Series:
    return entries["kind"] == objects["kind"]


def _surely_moved(entries: pd.DataFrame, objects: pd.DataFrame) -> pd.Series:
    return _moved(entries, objects) & (height_ratio(entries, objects) >= SAME_HEIGHT)


class Evidence(NamedTuple):
    """Evidence of points and rays at places."""

    own_points: NDArray[np.int64]  # Points of the kind of the entry
    own: NDArray[np.bool_]  # Whether they confirm it
    other: NDArray[np.bool_]  # Whether points of other upright kinds do
    empty_share: NDArray[np.float64]  # Share of the columns of voxels that hold no shaft; 0 where something stands


def evidence_of(seen: SeenSpace, kind: NDArray[np.str_], height: NDArray[np.float64]) -> Evidence:
    """Return the evidence about places.

    A shaft or trunk fills all slices of a column of voxels. A column holds none where rays crossed at least a quarter
    of its slices below the top and these have no points. No place is empty where points of any class fill the slices.
    """
    middle = (np.arange(SIDE) + 0.5) * CELL - HALF
    distance = np.hypot(middle[:, None], middle[None, :])
    radius = np.array([RADIUS[name] for name in kind])
    disc = distance[None] <= radius[:, None, None]
    top = np.clip(np.where(np.isnan(height), TOP, height), LOW + SLICE, TOP)
    lower = (np.arange(SLICES) + 1) * SLICE + LOW <= top[:, None] + 1e-9
    n_lower, least = lower.sum(axis=1), np.array([LEAST_OWN[name] for name in kind])
    own_points, own_slices = _in_disc(seen.own, disc, lower)
    other_points, other_slices = _in_disc(seen.other, disc, lower)
    all_points, all_slices = _in_disc(seen.hit, disc, lower)
    own = (own_points >= least) & ((own_slices >= LEAST_SLICES * n_lower) | (kind == "sign"))
    other = ~own & (other_points >= least) & (other_slices >= LEAST_OTHERS * n_lower)
    occupied = (all_points >= least) & ((all_slices >= LEAST_OTHERS * n_lower) | (kind == "sign"))
    free = (seen.free > 0) & (seen.hit == 0) & lower[:, :, None, None]
    no_shaft = free.sum(axis=1) >= np.maximum(2, FREE_SLICES * n_lower)[:, None, None]
    share = (no_shaft & disc).sum(axis=(1, 2)) / disc.sum(axis=(1, 2))
    empty = np.where(occupied | (n_lower < FEWEST_SLICES), 0.0, share)
    return Evidence(own_points, own, other, empty)


def _in_disc(
    counts: NDArray[np.uint16], disc: NDArray[np.bool_], lower: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the points of each place, and the number of its lower slices with any."""
    of_slice = (counts * disc[:, None]).sum(axis=(2, 3), dtype=np.int64)
    return of_slice.sum(axis=1), ((of_slice > 0) & lower).sum(axis=1)


def decide(
    entries: pd.DataFrame,
    objects: pd.DataFrame,
    matches: Matches,
    rows: NDArray[np.int64],
    evidence: Evidence,
    rays: NDArray[np.int64],
) -> pd.DataFrame:
    """Return the entries with their states, then the objects without an entry.

    `evidence` and `rays` (their number at each place) are about the entries of `rows`; others without a state are not
    visible.
    """
    found = Matches(matches.state.copy(), matches.row.copy(), matches.used.copy())
    state, by = found.state, np.full(len(entries), BY_OBJECT, dtype=object)
    by[state == ""], state[state == ""] = BY_RAYS, NOT_VISIBLE
    state[rows[evidence.empty_share >= EMPTY]] = NOT_FOUND

    def confirm_standing(standing: NDArray[np.bool_], points: str) -> None:
        own = rows[standing & np.isin(state[rows], (NOT_FOUND, NOT_VISIBLE))]
        state[own], by[own] = CONFIRMED, points

    # An object on which another entry hangs, such as a sign on a lamp, is first that of the entry of its kind.
    _match(entries, objects, found, MOVED, MOVED_REACH, _surely_moved, of_states=(NOT_FOUND,))
    _match(entries, objects, found, OTHER_KIND, min(REACH.values()), _alike_other)
    _match(entries, objects, found, CONFIRMED, max(REACH.values()), same_kind)
    confirm_standing(evidence.own, BY_POINTS)
    _match(entries, objects, found, OTHER_KIND, min(REACH.values()), other_kind)
    confirm_standing(evidence.other, BY_OTHERS)
    _match(entries, objects, found, MOVED, MOVED_REACH, _moved)
    by[found.row >= 0] = BY_OBJECT
    numbers = {"empty_share": np.full(len(state), np.nan), "points": np.zeros(len(state)), "rays": np.zeros(len(state))}
    for name, values in zip(numbers, (evidence.empty_share, evidence.own_points, rays), strict=True):
        numbers[name][rows] = values
    table = _with_objects(entries.assign(state=state, evidence=by, **numbers), objects, found.row)
    new = objects[~found.used & objects["kind"].isin(set(entries["kind"])).to_numpy()]
    columns = {"kind": new["kind"], "x": new["x"], "y": new["y"], "state": NEW, "evidence": BY_OBJECT}
    columns |= {"object_id": new["object_id"], "object_kind": new["kind"], "object_height": new["height"]}
    joined = pd.concat([table, pd.DataFrame(columns)], ignore_index=True)
    return joined.assign(**{name: joined[name].fillna(0).astype(np.int64) for name in ("points", "rays")})


def _with_objects(table: pd.DataFrame, objects: pd.DataFrame, row: NDArray[np.int64]) -> pd.DataFrame:
    """Return entries with number, kind, distance and height of their objects."""
    there = objects.reindex(pd.Index(row)).reset_index(drop=True)  # -1 is no row
    table = table.reset_index(drop=True)
    x, y, height = (there[name].astype(np.float64) for name in ("x", "y", "height"))
    dx, dy = x - table["x"], y - table["y"]
    return table.assign(
        object_id=there["object_id"].fillna(0).astype(np.int64),
        object_kind=there["kind"].fillna(""),
        object_height=height,
        distance=np.hypot(dx, dy),
        dx=dx,
        dy=dy,
        height_difference=height - table["height"],
    )
