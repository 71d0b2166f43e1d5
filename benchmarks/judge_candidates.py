"""Candidates of the inventory on streets, with their features and with what they are."""

from __future__ import annotations

import numpy as np
import pandas as pd
from judge_streets import SCHEME, Street, true_objects

from mlsroad_pipeline.algorithms.inventory.candidates import CANDIDATE_LIMITS, classify_stems, raised_labels
from mlsroad_pipeline.algorithms.inventory.evidence import SceneCells
from mlsroad_pipeline.algorithms.inventory.measured_rows import Evidence, find_candidates
from mlsroad_pipeline.algorithms.inventory.object_features import FEATURES
from mlsroad_pipeline.algorithms.inventory.rules import KINDS, rules_for_scheme
from mlsroad_pipeline.algorithms.inventory.voxels import find_fragments, join_voxels
from mlsroad_pipeline.algorithms.metrics.object_matching import REACH, assign_one_to_one
from mlsroad_pipeline.algorithms.models.object_judge import ObjectJudge

RULES = rules_for_scheme(SCHEME, changes=CANDIDATE_LIMITS)


def cells_of(street: Street) -> SceneCells:
    """Return the cells of a street, which is one scene."""
    core = np.ones(len(street.local), bool)
    return SceneCells(street.local, core=core, origin=street.origin, evidence=street.evidence)


def find_candidate_rows(street: Street, judge: ObjectJudge) -> pd.DataFrame:
    """Return the candidates of a street with their features, as `extract_objects` makes them."""
    cells = cells_of(street)
    labels = raised_labels(street.evidence, RULES)
    labels = classify_stems(street.local, street.height, labels, cells, rules=RULES, judge=judge)
    rows, features = [], []
    for name, rule in RULES.items():
        mine = np.flatnonzero(np.isin(labels, rule.labels))
        whole, _, of_whole, _ = find_fragments(
            street.local[mine], core=np.ones(len(mine), bool), confidence=np.ones(len(mine)),
            height_above_ground=street.height[mine], origin=street.origin, rule=rule,
        )  # fmt: skip
        if not len(whole):
            continue
        kept = np.flatnonzero(of_whole >= 0)
        table = cells.around(mine[kept], whole["fragment"].to_numpy()[of_whole[kept]])
        voxels, number, joined = join_voxels(
            whole.assign(object=whole["fragment"], scene=0), resolution=rule.resolution
        )
        voxel = joined[of_whole[kept]]
        evidence = Evidence(table.assign(object=table["fragment"]))
        part = np.full(len(number), -1)
        first = len(rows)
        for candidate in find_candidates(voxels, number, name, RULES, [street.name], evidence):
            part[candidate.voxels] = candidate.part
            row = {key: candidate.row[key] for key in ("kind", "x", "y", "height", "point_count")}
            rows.append({**row, "part": candidate.part, "own_kind": rule.kind})
            features.append(candidate.features)
        instance = _most_frequent(part[voxel], street.instance[mine[kept]])
        for row in rows[first:]:
            row["instance"], row["shared"] = instance.get(row["part"], (0, 0))
    table = pd.DataFrame(rows).join(pd.DataFrame(np.array(features), columns=list(FEATURES)).add_prefix("f: "))
    return table.assign(street=street.name)


def candidate_table(street: Street, judge: ObjectJudge) -> pd.DataFrame:
    """Return the candidates of a simulated street with their features and truth."""
    return _with_truth(find_candidate_rows(street, judge), true_objects(street))


def _most_frequent(part: np.ndarray, instance: np.ndarray) -> dict[int, tuple[int, int]]:
    """Return the object that most points of each part belong to, and their number."""
    counts = pd.DataFrame({"part": part, "instance": np.maximum(instance, 0)}).value_counts(sort=True).reset_index()
    best = counts.drop_duplicates("part")
    return {int(p): (int(i), int(n)) for p, i, n in best.itertuples(index=False)}


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
    return table.assign(true=true | seen_in_part(table, truth), ignored=ignored & ~true)


def seen_in_part(table: pd.DataFrame, truth: pd.DataFrame) -> np.ndarray:
    """Return which candidates are the largest piece of a counted vehicle, to which half of their points belong."""
    counted = truth.loc[truth["counted"] & (truth["kind"] == "vehicle"), "instance"]
    vehicle = (table["kind"] == "vehicle") & table["instance"].isin(counted)
    vehicle &= table["shared"] >= 0.5 * table["point_count"]
    largest = table["shared"].where(vehicle, -1).groupby(table["instance"]).transform("max")
    return (vehicle & (table["shared"] == largest)).to_numpy()
