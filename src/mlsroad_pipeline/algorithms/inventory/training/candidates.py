"""Candidates and upright lines of simulated streets, with their features and their truth."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import (
    CandidateScene,
    candidate_rules,
    find_candidate_table,
    raised_labels,
    sign_probability,
    stem_points,
)
from mlsroad_pipeline.algorithms.inventory.objects.evidence import SceneCells
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import NEITHER, POLE, STEM, TRUNK, ObjectClassifier
from mlsroad_pipeline.algorithms.inventory.objects.plates import PLATE, PLATE_FEATURES, find_plates
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, KINDS
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import STEM_FEATURES, find_scene_stems
from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import REACH
from mlsroad_pipeline.algorithms.inventory.training import streets

SHORTEST, STRETCHED = 0.4, 1.2
"""Least length of a vehicle seen in part, and largest one of a moving vehicle, as multiples of its true length."""

POLES = [TAXONOMY[name] for name, kind in KIND_OF_CLASS.items() if kind in ("pole", "sign")]
TRUNKS = [TAXONOMY[name] for name in ("trunk", "tree", "palm")]


def parts_of_street(
    *,
    points: Mapping[str, NDArray],
    objects: pd.DataFrame,
    labels: Mapping[str, NDArray],
    name: str,
    variants: tuple[str, ...],
    scheme: ClassScheme,
) -> dict[str, pd.DataFrame]:
    """Return the stems and the plates of variants of a street; those with gaps are left out."""
    tables: dict[str, list[pd.DataFrame]] = {
        STEM: [pd.DataFrame({"street": []})],
        PLATE: [pd.DataFrame({"street": []})],
    }
    for variant in variants if len(points["xyz"]) else ():
        if variant != streets.CUT:
            street = streets.variant_of_street(name, variant, points, objects, labels, scheme)
            cells = _scene_of(street).cells
            tables[STEM].append(stem_table(street, cells))
            tables[PLATE].append(plate_table(street, cells))
    return {part: pd.concat(found[1:] or found, ignore_index=True) for part, found in tables.items()}


def candidates_of_street(
    *,
    points: Mapping[str, NDArray],
    objects: pd.DataFrame,
    labels: Mapping[str, NDArray],
    name: str,
    variants: tuple[str, ...],
    scheme: ClassScheme,
    classifier: ObjectClassifier,
) -> dict[str, pd.DataFrame]:
    """Return the candidates of variants of a street, and the number of true objects of each variant and kind."""
    tables, counts = [pd.DataFrame({"street": []})], []
    for variant in variants if len(points["xyz"]) else ():
        street = streets.variant_of_street(name, variant, points, objects, labels, scheme)
        truth = streets.true_objects(street)
        tables.append(with_truth(find_candidate_rows(street, classifier), truth).assign(variant=variant))
        there = truth["counted"] | (truth["enough"] & (truth["kind"] == "vehicle"))
        counts += [(variant, kind, int((truth["kind"] == kind)[there].sum())) for kind in KINDS]
    found = pd.concat(tables[1:] or tables, ignore_index=True)
    return {"candidates": found, "true": pd.DataFrame(counts, columns=["variant", "kind", "objects"])}


def candidates_of_boxes(
    street: streets.Street, boxes: pd.DataFrame, members: Sequence[NDArray[np.int64]], classifier: ObjectClassifier
) -> dict[str, pd.DataFrame]:
    """Return the vehicles among the candidates of a scan, and the number of true ones; `members` are rows of points."""
    instance = np.zeros(len(street.local), np.int64)
    for k, rows in enumerate(members):
        instance[rows] = k + 1
    enough = np.array([len(rows) >= streets.LEAST_POINTS["vehicle"] for rows in members], bool)
    truth = pd.DataFrame({
        "kind": "vehicle", "x": boxes["x"], "y": boxes["y"], "length": boxes["length"], "enough": enough,
        "counted": enough & boxes["counted"].to_numpy(bool), "instance": np.arange(1, len(boxes) + 1),
    })  # fmt: skip
    found = find_candidate_rows(street._replace(instance=instance), classifier)
    found = with_truth(found[found["kind"] == "vehicle"].reset_index(drop=True), truth).assign(variant=streets.RECORDED)
    true = pd.DataFrame({"variant": [streets.RECORDED], "kind": ["vehicle"], "objects": [int(enough.sum())]})
    return {"candidates": found, "true": true}


def stem_table(street: streets.Street, cells: SceneCells) -> pd.DataFrame:
    """Return the features of the stems of a street, and what each is."""
    labels = raised_labels(street.evidence, candidate_rules(street.scheme, {}))
    stems = find_scene_stems(street.local, street.height, stem_points(street.evidence, labels), cells)
    table = pd.DataFrame(stems.features, columns=list(STEM_FEATURES))
    inside = stems.owner >= 0
    true, n = street.truth[stems.points[inside]], len(table)
    size = np.maximum(np.bincount(stems.owner[inside], minlength=n), 1)
    trunk = np.bincount(stems.owner[inside], weights=np.isin(true, TRUNKS), minlength=n) / size
    pole = np.bincount(stems.owner[inside], weights=np.isin(true, POLES), minlength=n) / size
    return table.assign(target=np.where(trunk > 0.5, TRUNK, np.where(pole > 0.4, POLE, NEITHER)), street=street.name)


def plate_table(street: streets.Street, cells: SceneCells) -> pd.DataFrame:
    """Return the features of the pieces of a street that may be plates, and whether most of each is of a sign."""
    plates = find_plates(street.local, street.height, sign_probability(street.evidence), cells)
    share = [float(np.isin(street.truth[rows], streets.SIGNS).mean()) for rows in plates.members]
    table = pd.DataFrame(plates.features, columns=list(PLATE_FEATURES))
    return table.assign(target=np.array(share) > 0.5, street=street.name)


def find_candidate_rows(street: streets.Street, classifier: ObjectClassifier) -> pd.DataFrame:
    """Return the candidates of a street with their features."""
    rules = candidate_rules(street.scheme, {})
    return find_candidate_table(_scene_of(street), rules, classifier).assign(street=street.name)


def _scene_of(street: streets.Street) -> CandidateScene:
    return CandidateScene(street.local, street.origin, street.height, street.evidence, street.instance)


def with_truth(table: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Add `true` and `ignored`: first candidates of their own class are matched, then alternatives.

    A vehicle that is seen in part has its middle elsewhere, see `_seen_in_part`.
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
    piece, short = _seen_in_part(table, truth)
    true |= piece & ~short
    return table.assign(true=true, ignored=(ignored | short) & ~true)


def _seen_in_part(table: pd.DataFrame, truth: pd.DataFrame) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
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
