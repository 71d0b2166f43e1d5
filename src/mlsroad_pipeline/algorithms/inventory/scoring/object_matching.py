"""One-to-one matching of an inventory of objects with a table of true objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one

REACH = {"pole": 0.5, "sign": 0.5, "tree": 1.0, "vehicle": 1.0}
"""Kind to the largest distance of a pair in plan, metres: base of a pole or tree, centre of a sign or vehicle."""
OTHER_REACH = 1.0
"""Largest distance for kinds that `REACH` does not list, metres."""
RIGHT, FALSE, IGNORED = "right", "false", "ignored"
FOUND, MISSED = "found", "missed"


@dataclass(frozen=True)
class MatchedObjects:
    """Outcome of every listed and of every true object."""

    # The listed objects with `outcome` (``right``, ``false``, ``ignored``), `true_row` (row of the true object, -1
    # without one), `distance` (in plan, metres; NaN without one) and `true_kind` (of a false object: the kind of the
    # nearest true object of another kind that is within reach, empty without one)
    objects: pd.DataFrame
    # The true objects with `outcome` (``found``, ``missed``, ``ignored``) and `row` (of the listed object, or -1)
    truth: pd.DataFrame


def match_objects(
    objects: pd.DataFrame, truth: pd.DataFrame, *, reach: Mapping[str, float] | None = None
) -> MatchedObjects:
    """Match listed with true objects of the same kind, each at most once.

    A listed object without a true object is ignored where it is near a true object that does not count: within reach,
    and half of its length. Objects with `inside` False are ignored unless they match.
    """
    limits = {**REACH, **(reach or {})}
    where, expected = (table[["x", "y"]].to_numpy(dtype=np.float64) for table in (objects, truth))
    counted = truth["counted"].to_numpy(dtype=bool) if "counted" in truth else np.ones(len(truth), bool)
    inside = objects["inside"].to_numpy(dtype=bool) if "inside" in objects else np.ones(len(objects), bool)
    listed = np.where(inside, FALSE, IGNORED).astype(object)
    wanted = np.where(counted, MISSED, IGNORED).astype(object)
    true_row, row = np.full(len(objects), -1), np.full(len(truth), -1)
    for kind in sorted(set(objects["kind"]) & set(truth["kind"])):
        limit = limits.get(kind, OTHER_REACH)
        mine = np.flatnonzero(objects["kind"] == kind)
        own = np.flatnonzero((truth["kind"] == kind) & counted)
        a, b = assign_one_to_one(where[mine], expected[own], limit)
        true_row[mine[a]], row[own[b]] = own[b], mine[a]
        listed[mine[a]], wanted[own[b]] = RIGHT, FOUND
        spare = truth[(truth["kind"] == kind) & ~counted]
        free = mine[listed[mine] == FALSE]
        listed[free[_beside(where[free], spare, limit)]] = IGNORED
    gap = np.where(true_row >= 0, np.hypot(*(where - expected[true_row]).T) if len(truth) else 0.0, np.nan)
    outcome = {"outcome": listed, "true_row": true_row, "distance": gap}
    found = objects.assign(**outcome, true_kind=_kinds_there(objects["kind"], where, listed, truth, limits))
    return MatchedObjects(found, truth.assign(outcome=wanted, row=row))


def _beside(where: NDArray[np.float64], spare: pd.DataFrame, limit: float) -> NDArray[np.bool_]:
    """Return which places are near one of some objects."""
    if spare.empty or not len(where):
        return np.zeros(len(where), bool)
    length = spare["length"].fillna(0.0).to_numpy(dtype=np.float64) if "length" in spare else np.zeros(len(spare))
    gap = np.hypot(*(where[:, None] - spare[["x", "y"]].to_numpy(dtype=np.float64)).transpose(2, 0, 1))
    near: NDArray[np.bool_] = (gap <= limit + length / 2).any(axis=1)
    return near


def _kinds_there(
    kinds: pd.Series, where: NDArray[np.float64], outcome: NDArray, truth: pd.DataFrame, limits: Mapping[str, float]
) -> NDArray[np.object_]:
    """Return the kind of the nearest true object of another kind within reach of each false object."""
    named = np.full(len(where), "", dtype=object)
    for kind, others in truth.groupby("kind", sort=True):
        tree = cKDTree(others[["x", "y"]].to_numpy(dtype=np.float64))
        rows = np.flatnonzero((outcome == FALSE) & (kinds != kind).to_numpy() & (named == ""))
        near = tree.query(where[rows], distance_upper_bound=limits.get(str(kind), OTHER_REACH))[0]
        named[rows[np.isfinite(near)]] = kind
    return named
