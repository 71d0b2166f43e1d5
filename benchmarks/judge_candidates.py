"""Candidates of the inventory on streets, with their features and with what they are."""

from __future__ import annotations

import numpy as np
import pandas as pd
from judge_streets import SCHEME, Street, true_objects

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import (
    CandidateScene,
    candidate_rules,
    find_candidate_table,
)
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import REACH

RULES = candidate_rules(SCHEME, {})
SHORTEST, STRETCHED = 0.4, 1.2
"""Least length of a vehicle seen in part, and largest one of a moving vehicle, as multiples of its true length."""


def scene_of(street: Street) -> CandidateScene:
    """Return a street as one scene."""
    return CandidateScene(street.local, street.origin, street.height, street.evidence, street.instance)


def find_candidate_rows(street: Street, judge: ObjectClassifier) -> pd.DataFrame:
    """Return the candidates of a street with their features."""
    return find_candidate_table(scene_of(street), RULES, judge).assign(street=street.name)


def candidate_table(street: Street, judge: ObjectClassifier) -> pd.DataFrame:
    """Return the candidates of a simulated street with their features and truth."""
    return _with_truth(find_candidate_rows(street, judge), true_objects(street))


def _with_truth(table: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Add `true` and `ignored`: first candidates of their own class are matched, then alternatives.

    A vehicle that is seen in part has its middle elsewhere, see `seen_in_part`.
    Candidates beside a true object that does not count are ignored.
    """
    true, ignored = np.zeros(len(table), bool), np.zeros(len(table), bool)
    where = table[["x", "y"]].to_numpy()
    for kind in KINDS:
        own = truth[(truth["kind"] == kind) & truth["counted"]]
        left = np.ones(len(own), bool)
        for same in (True, False):
            rows = np.flatnonzero((table["kind"] == kind) & ((table["own_kind"] == kind) == same) & ~true)
            free = np.flatnonzero(left)
            a, b = assign_one_to_one(where[rows], own[["x", "y"]].to_numpy()[free], REACH[kind])
            left[free[b]] = False
            true[rows[a]] = True
        rest = truth[(truth["kind"] == kind) & ~truth["counted"]]
        rows = np.flatnonzero((table["kind"] == kind).to_numpy() & ~true)
        gap = np.hypot(*(where[rows, None] - rest[["x", "y"]].to_numpy()).transpose(2, 0, 1))
        reach = REACH[kind] + (rest["length"].to_numpy() / 2 if kind == "vehicle" else 0.0)
        ignored[rows[(gap <= reach).any(axis=1)]] = True
    piece, short = seen_in_part(table, truth)
    true |= piece & ~short
    return table.assign(true=true, ignored=(ignored | short) & ~true)


def seen_in_part(table: pd.DataFrame, truth: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return which candidates are the largest piece of a vehicle, and which of these are too short to count.

    Half of the points of the piece belong to the vehicle. Moving vehicles are among them unless their motion stretches
    them: simulated lorries and buses all move.
    """
    vehicles = truth[truth["enough"] & (truth["kind"] == "vehicle")].set_index("instance")
    vehicle = (table["kind"] == "vehicle") & table["instance"].isin(vehicles.index)
    vehicle &= table["shared"] >= 0.5 * table["point_count"]
    largest = table["shared"].where(vehicle, -1).groupby(table["instance"]).transform("max")
    whole = table["instance"].map(vehicles["length"])
    piece = vehicle & (table["shared"] == largest) & (table["f: length"] <= STRETCHED * whole + 0.5)
    return piece.to_numpy(), (piece & (table["f: length"] < SHORTEST * whole)).to_numpy()
