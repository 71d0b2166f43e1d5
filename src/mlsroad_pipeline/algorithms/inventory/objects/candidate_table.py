"""Labels of candidates, and the table of all candidates of a scene with their features for training."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.evidence import SceneCells
from mlsroad_pipeline.algorithms.inventory.objects.fragments import find_fragments, join_voxels
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import FEATURES, Evidence, find_candidates
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import POLE, STEM, TRUNK, Classifier
from mlsroad_pipeline.algorithms.inventory.objects.plates import PLATE, SIGN, chosen_plates, find_plates
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule, rules_for_scheme
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import Stems, find_scene_stems

WEIGHTS = {"pole": 4.0, "sign": 5.0, "vehicle": 1.5, "tree": 1.0}
"""Factors of the class probabilities by kind of object; wires have that of poles."""

CANDIDATE_LIMITS: dict[str, dict[str, float]] = {
    "pole": {"min_height": 0.8, "max_width": 12.0, "max_clearance": 8.0},
    "sign": {},
    "vehicle": {"min_height": 0.5, "min_width": 0.8, "max_clearance": 1.5},
    "tree": {"max_clearance": 8.0},
}
"""Rules of candidates for an object classifier, where they differ from those of objects."""

_LEAST_TRUNK, _LEAST_POLE = 0.7, 0.5  # probabilities from which a stem changes the class of its points
_LEAST_PLATE = 0.15  # probability from which a plate changes the class of its points
_SURE_WALL = 0.9  # probability of a building or wall from which a point is of no upright line, which halves their time
_NEVER_STEMS = ("paved ground", "natural ground", "vehicle", "wire")  # groups of classes without upright lines


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


def forming_labels(
    local: NDArray[np.floating],
    height: NDArray[np.floating],
    evidence: ClassEvidence,
    cells: SceneCells,
    *,
    rules: Mapping[str, ObjectRule],
    classifier: Classifier,
) -> NDArray[np.int16]:
    """Return the class of each point for the forming of candidates: raised, of its upright line, of its plate."""
    out = raised_labels(evidence, rules)
    of_kind = {kind: [x for rule in rules.values() if rule.kind == kind for x in rule.labels] for kind in WEIGHTS}
    if of_kind["pole"] and of_kind["tree"]:
        stems = find_scene_stems(local, height, stem_points(evidence, out), cells)
        _classify_stems(out, stems, of_kind, classifier)
    if of_kind["sign"]:
        plates = find_plates(local, height, sign_probability(evidence), cells)
        if len(plates.members):
            likely = classifier.probabilities(PLATE, plates.features)[:, 0]
            out[chosen_plates(plates, likely, _LEAST_PLATE)] = of_kind["sign"][0]
    return out


def stem_points(evidence: ClassEvidence, labels: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the points that may belong to poles, posts and trunks: no ground, vehicles, wires or sure walls."""
    never = evidence.groups[:, [GROUPS.index(name) for name in _NEVER_STEMS]].sum(axis=1) > 0.5
    wall = evidence.of_groups[:, [GROUPS.index(name) for name in ("building", "wall")]].sum(axis=1) > _SURE_WALL
    return np.flatnonzero(np.append(~never, False)[labels] & ~np.append(wall, True)[evidence.owner])


def sign_probability(evidence: ClassEvidence) -> NDArray[np.float32]:
    """Return the probability of a sign of each point."""
    return np.append(evidence.of_groups[:, SIGN], np.float32(0))[evidence.owner]


def _classify_stems(
    out: NDArray[np.int16], stems: Stems, of_kind: Mapping[str, list[int]], classifier: Classifier
) -> None:
    """Give the points of each upright line one class, in place."""
    if not len(stems.features):
        return
    likely = classifier.probabilities(STEM, stems.features)
    on = stems.owner >= 0
    points, owner = stems.points[on], stems.owner[on]
    upright = np.isin(out[points], [*of_kind["pole"], *of_kind["sign"]])
    trunk, pole = upright & (likely[owner, TRUNK] > _LEAST_TRUNK), ~upright & (likely[owner, POLE] > _LEAST_POLE)
    out[points[trunk]], out[points[pole]] = of_kind["tree"][0], of_kind["pole"][0]


FEATURE_COLUMNS = tuple(f"f: {name}" for name in FEATURES)
"""Columns of the features in a table of candidates."""

_ROW = ("kind", "x", "y", "height", "point_count")


@dataclass(frozen=True)
class CandidateScene:
    """A scene whose candidates are wanted."""

    local: NDArray[np.float64]  # Points relative to `origin`, metres
    origin: NDArray[np.float64]  # World coordinates of the local origin, metres
    height: NDArray[np.float64]  # Heights above the ground, metres
    evidence: ClassEvidence  # Class probabilities of the points
    instance: NDArray[np.integer]  # Object that each point is known to belong to, 0 for none

    @property
    def cells(self) -> SceneCells:
        """Cells of the scene, all of which is core."""
        core = np.ones(len(self.local), np.bool_)
        return SceneCells(self.local, core=core, origin=self.origin, evidence=self.evidence)


def find_candidate_table(
    scene: CandidateScene, rules: Mapping[str, ObjectRule], classifier: Classifier
) -> pd.DataFrame:
    """Find the candidates of a scene as `extract_objects` does."""
    cells = scene.cells
    labels = forming_labels(scene.local, scene.height, scene.evidence, cells, rules=rules, classifier=classifier)
    rows: list[dict[str, object]] = []
    features = [np.zeros((0, len(FEATURES)), np.float32)]
    for name, rule in rules.items():
        mine = np.flatnonzero(np.isin(labels, rule.labels))
        found = _of_class(scene, cells, mine, name, rules)
        rows += found[0]
        features.append(found[1])
    table = pd.DataFrame(rows, columns=[*_ROW, "own_kind", "part", "instance", "shared"])
    return table.join(pd.DataFrame(np.concatenate(features), columns=list(FEATURE_COLUMNS)))


def _of_class(
    scene: CandidateScene, cells: SceneCells, mine: NDArray[np.int64], name: str, rules: Mapping[str, ObjectRule]
) -> tuple[list[dict[str, object]], NDArray[np.float32]]:
    """Return the rows and the features of the candidates that points of one class form."""
    rule = rules[name]
    whole, _, of_whole, _ = find_fragments(
        scene.local[mine],
        core=np.ones(len(mine), np.bool_),
        confidence=np.ones(len(mine)),
        height_above_ground=scene.height[mine],
        origin=scene.origin,
        rule=rule,
    )
    if not len(whole):
        return [], np.zeros((0, len(FEATURES)), np.float32)
    kept = np.flatnonzero(of_whole >= 0)
    table = cells.around(mine[kept], whole["fragment"].to_numpy()[of_whole[kept]])
    voxels, number, joined = join_voxels(whole.assign(object=whole["fragment"], scene=0), resolution=rule.resolution)
    evidence = Evidence(table.assign(object=table["fragment"]))
    part = np.full(len(number), -1)
    candidates = list(find_candidates(voxels, number, name, rules, ["scene"], evidence))
    for candidate in candidates:
        part[candidate.voxels] = candidate.part
    instance = _most_frequent(part[joined[of_whole[kept]]], scene.instance[mine[kept]])
    rows = []
    for candidate in candidates:
        most, shared = instance.get(candidate.part, (0, 0))
        row = {key: candidate.row[key] for key in _ROW}
        rows.append({**row, "own_kind": rule.kind, "part": candidate.part, "instance": most, "shared": shared})
    features = np.array([candidate.features for candidate in candidates], np.float32)
    return rows, features.reshape(len(candidates), len(FEATURES))


def _most_frequent(part: NDArray[np.int64], instance: NDArray[np.integer]) -> dict[int, tuple[int, int]]:
    """Return the object that most points of each part belong to, and their number."""
    counts = pd.DataFrame({"part": part, "instance": np.maximum(instance, 0)}).value_counts(sort=True).reset_index()
    best = counts.drop_duplicates("part")
    return {int(p): (int(i), int(n)) for p, i, n in best.itertuples(index=False)}
