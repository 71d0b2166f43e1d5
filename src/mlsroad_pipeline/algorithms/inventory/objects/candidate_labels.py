"""Classes of the points that form candidate objects, from class probabilities and upright lines.

A detector that takes the most probable class of each point loses thin objects in front of others. Here the
probabilities of poles, signs and vehicles are raised, so that more candidates arise than objects. An object
classifier scores each. Upright lines among points of poles, signs and trees are classified as a whole: trunks become
part of trees, and posts in crowns part of poles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.classifying import POLE, STEM, TRUNK, Classifier
from mlsroad_pipeline.algorithms.inventory.objects.evidence import SceneCells
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule, rules_for_scheme
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import find_scene_stems

WEIGHTS = {"pole": 2.0, "sign": 3.0, "vehicle": 1.5, "tree": 1.0}
"""Factors of the class probabilities by kind of object; wires have that of poles."""

CANDIDATE_LIMITS: dict[str, dict[str, float]] = {
    "pole": {"min_height": 0.8, "max_width": 12.0, "max_clearance": 8.0},
    "sign": {},
    "vehicle": {"min_height": 0.5, "min_width": 0.8, "max_clearance": 1.5},
    "tree": {"max_clearance": 8.0},
}
"""Rules of candidates for an object classifier, where they differ from those of objects."""

_LEAST_TRUNK, _LEAST_POLE = 0.7, 0.5  # probabilities from which a stem changes the class of its points


def candidate_rules(scheme: ClassScheme, changes: Mapping[str, Mapping[str, Any]]) -> dict[str, ObjectRule]:
    """Return the rules of the candidates for the classes of a scheme."""
    kinds = {kind: {**limits, **changes.get(kind, {})} for kind, limits in CANDIDATE_LIMITS.items()}
    return rules_for_scheme(scheme, changes={**changes, **kinds})


def raised_labels(evidence: ClassEvidence, rules: Mapping[str, ObjectRule]) -> NDArray[np.int16]:
    """Return the most probable class of each point after raising the classes of objects."""
    factor = np.where(evidence.groups[:, GROUPS.index("wire")] > 0.5, WEIGHTS["pole"], 1.0)
    for rule in rules.values():
        factor[list(rule.labels)] = WEIGHTS[rule.kind]
    best = (evidence.probabilities * factor).argmax(axis=1).astype(np.int16)
    return np.where(evidence.owner >= 0, np.append(best, np.int16(-1))[evidence.owner], np.int16(-1))


def classify_stems(
    local: NDArray[np.floating],
    height: NDArray[np.floating],
    labels: NDArray[np.integer],
    cells: SceneCells,
    *,
    rules: Mapping[str, ObjectRule],
    classifier: Classifier,
) -> NDArray[np.int16]:
    """Give the points of each upright line one class."""
    out = np.asarray(labels).astype(np.int16)
    of_kind = {kind: [x for rule in rules.values() if rule.kind == kind for x in rule.labels] for kind in WEIGHTS}
    if not (of_kind["pole"] and of_kind["tree"]):
        return out
    upright = [*of_kind["pole"], *of_kind["sign"]]
    points = np.flatnonzero(np.isin(out, [*upright, *of_kind["tree"]]))
    stems = find_scene_stems(local, height, points, cells)
    if not len(stems.features):
        return out
    probability = classifier.probabilities(STEM, stems.features)
    probability = np.concatenate([probability, np.zeros((1, probability.shape[1]))])[
        stems.owner
    ]  # points of no stem are last
    is_tree = np.isin(out[points], of_kind["tree"])
    out[points[~is_tree & (probability[:, TRUNK] > _LEAST_TRUNK)]] = of_kind["tree"][0]
    out[points[is_tree & (probability[:, POLE] > _LEAST_POLE)]] = of_kind["pole"][0]
    return out
