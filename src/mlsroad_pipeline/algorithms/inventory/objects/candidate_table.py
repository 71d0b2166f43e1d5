"""Table of all candidates of a scene with their features, to train an object classifier."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.candidate_labels import classify_stems, raised_labels
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.classifying import Classifier
from mlsroad_pipeline.algorithms.inventory.objects.evidence import SceneCells
from mlsroad_pipeline.algorithms.inventory.objects.fragments import find_fragments, join_voxels
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import Evidence, find_candidates
from mlsroad_pipeline.algorithms.inventory.objects.object_features import FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import ObjectRule

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
    labels = raised_labels(scene.evidence, rules)
    labels = classify_stems(scene.local, scene.height, labels, cells, rules=rules, classifier=classifier)
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
