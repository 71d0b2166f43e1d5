"""Candidates, their evidence and the object classifier: planted cells, surveys cut anywhere, decisions."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from references.inventory import planted_box, planted_pole, planted_tree

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import WEIGHTS, raised_labels
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import (
    GROUPS,
    ClassEvidence,
    evidence_of_labels,
    group_shares,
)
from mlsroad_pipeline.algorithms.inventory.objects.evidence import CELL, SUMS, ZONES, SceneCells
from mlsroad_pipeline.algorithms.inventory.objects.extraction import extract_objects
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.merging import merge_scenes
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import (
    NEITHER,
    POLE,
    REASONS,
    STEM,
    TRUNK,
    ObjectClassifier,
)
from mlsroad_pipeline.algorithms.inventory.objects.plates import PLATE, PLATE_FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS, rules_for_scheme
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import STEM_FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.trunks import find_trunks, split_trees
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import Voxels
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

SCHEME = ClassScheme(
    "street",
    ("ground", "pole", "sign", "vehicle", "tree", "mixed"),
    (("road",), ("light_pole",), ("traffic_sign",), ("car",), ("tree", "trunk"), ("building", "wall", "bench")),
    (),
    (2, 64, 65, 66, 5, 1),
)
RULES = rules_for_scheme(SCHEME)
UTM = np.array([583_000.0, 4_477_000.0, 120.0])


class Planted:
    """Classifier of the evidence alone: the share of the class that an object should have."""

    def probabilities(self, classifier, features):
        if classifier == STEM:
            own = features[:, [STEM_FEATURES.index("own tree"), STEM_FEATURES.index("own pole")]]
            return np.eye(3)[np.where(own[:, 0] > 0.6, TRUNK, np.where(own[:, 1] > 0.6, POLE, NEITHER))]
        if classifier == PLATE:
            return (features[:, [PLATE_FEATURES.index("wide")]] > 0.4).astype(np.float64)
        return features[:, [FEATURES.index(f"own {classifier}")]].astype(np.float64)

    def reasons(self, classifier, features):
        return [f"{classifier} of {np.exp(row[FEATURES.index('log_points')]):.0f} points" for row in features]


def planted_street():
    """Objects along 40 m, several on the border at 20 m; a tenth of each object's points are of another class."""
    parts = [
        (1, planted_pole((5.0, 4.0, 0.0), 8.0)),
        (1, planted_pole((20.0, 4.0, 0.0), 6.0, tilt_degrees=4, azimuth_degrees=90)),
        (2, planted_box((12.0, -4.0, 2.0), 0.6, 0.02, 0.6, azimuth_degrees=90)),
        (3, planted_box((20.0, 0.0, 0.2), 4.4, 1.8, 1.5, azimuth_degrees=90)),
        (4, planted_tree((20.3, 9.0, 0.0), 7.0, 2.4)),
        (4, planted_tree((30.0, 9.0, 0.0), 9.0, 2.6)),
        (0, np.stack([*np.meshgrid(np.arange(0, 40, 0.15), np.arange(-6, 12, 0.15)), ], axis=-1).reshape(-1, 2)),
    ]  # fmt: skip
    parts[-1] = (0, np.column_stack([parts[-1][1], np.zeros(len(parts[-1][1]))]))
    xyz = np.concatenate([points for _, points in parts])
    label = np.concatenate([np.full(len(points), k) for k, points in parts])
    draw = np.random.default_rng(3)
    order = draw.permutation(len(xyz))
    xyz, label = xyz[order], label[order]
    probabilities = np.full((len(xyz), len(SCHEME)), 0.04)
    probabilities[np.arange(len(xyz)), label] = 0.8
    return xyz, label, probabilities.astype(np.float32)


def cut_and_merged(*, cuts=(), least_score=0.0, buffer=3.0, **limits):
    """Return the merged objects of the planted street, and the points of each scene with their numbers."""
    xyz, label, probabilities = planted_street()
    pieces, counts = [], []
    for k, (low, high) in enumerate(pairwise([-np.inf, *cuts, np.inf])):
        near = np.flatnonzero((xyz[:, 0] >= low - buffer) & (xyz[:, 0] < high + buffer))
        core = (xyz[near, 0] >= low) & (xyz[near, 0] < high)
        origin = UTM + (10.0 * k, 0.0, 0.0)
        evidence = ClassEvidence(probabilities[near], np.arange(len(near)), group_shares(SCHEME))
        pieces.append(
            extract_objects(
                xyz[near] - (10.0 * k, 0.0, 0.0), label[near], np.ones(len(near)), classes=RULES, core=core,
                origin=origin, height_above_ground=xyz[near, 2], scene=f"scene_{k:05d}", evidence=evidence,
                classifier=Planted(),
            )
        )  # fmt: skip
    merged = merge_scenes(pieces, classes=RULES, classifier=Planted(), least_score=least_score, **limits)
    for piece in pieces:
        counts.append(np.bincount(merged.numbers[piece.scene][piece.part], minlength=len(merged.objects) + 1))
    return merged.objects, np.sum(counts, axis=0)


def test_groups_of_a_scheme():
    shares = group_shares(SCHEME)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-6)
    assert shares[0, GROUPS.index("paved ground")] == 1.0
    np.testing.assert_allclose(
        shares[5, [GROUPS.index(name) for name in ("building", "wall", "other")]], 1 / 3, rtol=1e-6
    )


def test_evidence_of_labels_alone():
    evidence = evidence_of_labels(np.array([1, 4, -1]), np.array([0.5, 1.0, 0.0]), SCHEME)
    np.testing.assert_allclose(evidence.probabilities.sum(axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(evidence.probabilities[evidence.owner[0]], [0.1, 0.5, 0.1, 0.1, 0.1, 0.1], rtol=1e-6)
    assert evidence.probabilities[evidence.owner[1]].tolist() == [0, 0, 0, 0, 1, 0]
    assert evidence.owner[2] == -1


def test_classes_of_objects_are_raised():
    probabilities = np.array([[0.55, 0.3, 0.0, 0.0, 0.15, 0.0], [0.78, 0.0, 0.12, 0.0, 0.1, 0.0]], np.float32)
    evidence = ClassEvidence(probabilities, np.array([0, 1, -1]), group_shares(SCHEME))
    assert 0.3 * WEIGHTS["pole"] > 0.55 and 0.12 * WEIGHTS["sign"] < 0.78
    assert raised_labels(evidence, RULES).tolist() == [1, 0, -1]


def test_sums_of_evidence_are_those_of_cells():
    """A column of three cells with a cell beside it, one above, one below and one out of reach."""
    centres = (np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2], [3, 0, 1], [0, 0, 5], [0, 1, -3], [9, 0, 0]]) + 0.5) * CELL
    xyz = np.repeat(centres, [1, 4, 1, 2, 3, 1, 5], axis=0)
    group = np.repeat([6, 6, 7, 0, 2, 8, 4], [1, 4, 1, 2, 3, 1, 5])
    evidence = ClassEvidence(np.eye(len(GROUPS), dtype=np.float32), group, np.eye(len(GROUPS), dtype=np.float32))
    cells = SceneCells(xyz, core=np.ones(len(xyz), bool), origin=np.zeros(3), evidence=evidence)
    table = cells.around(np.arange(6), np.zeros(6, np.int64))
    sums = pd.Series(table[list(SUMS)].sum(), index=SUMS)
    expected = {"own: pole": 2.0, "own: sign": 1.0, "beside: paved ground": 1.0, "above: tree": 1.0, "below: wire": 1.0}
    assert sums[sums > 0].to_dict() == pytest.approx(expected)
    assert len(table) == 3 and len(SUMS) == len(ZONES) * len(GROUPS)


def test_trunks_separate_trees():
    """Two trees with touching crowns of one height: the canopy has no valley."""
    trees = [planted_tree((x, 0.0, 0.0), 6.0, 2.0) for x in (0.0, 2.5)]
    xyz = np.concatenate(trees)
    n = len(xyz)
    whole = np.zeros(n)
    voxels = Voxels(xyz, xyz, xyz, whole, np.ones(n, int), np.zeros(n, int), np.ones(n), np.zeros(n, np.int32))
    trunks = find_trunks(voxels)
    np.testing.assert_allclose([(t.x, t.y) for t in trunks], [(0.0, 0.0), (2.5, 0.0)], atol=0.05)
    part = split_trees(voxels, spacing=3.0, depth=1.0)
    first = part[: len(trees[0])]
    low = xyz[:, 2] < 2.0
    assert len(np.unique(part)) == 2
    assert len(set(first[low[: len(first)]])) == 1 and len(set(part[len(first) :][low[len(first) :]])) == 1


@pytest.mark.parametrize("cuts", [(20.0,), (12.0, 21.0)])
def test_classified_objects_do_not_depend_on_the_cut(cuts):
    whole, counts = cut_and_merged()
    assert sorted(whole["kind"]) == ["pole", "pole", "sign", "tree", "tree", "vehicle"]
    assert (whole["score"] > 0.5).all()
    assert (counts[1:] == whole["point_count"]).all()
    pieces, counts = cut_and_merged(cuts=cuts)
    text = ["scene", "reasons"]
    assert (counts[1:] == pieces["point_count"]).all()
    pd.testing.assert_frame_equal(pieces.drop(columns=[*text, "score"]), whole.drop(columns=[*text, "score"]))
    np.testing.assert_allclose(pieces["score"], whole["score"], atol=2e-4)
    assert pieces["reasons"].tolist() == whole["reasons"].tolist()
    assert all(f"of {n} points" in reasons for n, reasons in zip(whole["point_count"], whole["reasons"], strict=True))


def test_objects_below_the_least_score_are_left_out():
    whole, _ = cut_and_merged(cuts=(20.0,))
    least = float(np.sort(whole["score"])[2])
    listed, counts = cut_and_merged(cuts=(20.0,), least_score=least)
    kept = whole[whole["score"] >= least]
    assert len(listed) == len(kept) < len(whole)
    assert listed["object_id"].tolist() == list(range(1, len(kept) + 1))
    assert (counts[1:] == kept["point_count"]).all()


def test_a_plate_on_a_mast_is_a_sign_and_the_mast_stays_a_pole():
    """All points are labelled pole; the probability of a sign is raised on a plate of 0.6 m alone."""
    mast, plate = planted_pole((5.0, 4.0, 0.0), 8.0), planted_box((5.0, 3.85, 2.6), 0.6, 0.02, 0.6, azimuth_degrees=90)
    xyz = np.concatenate([mast, plate])
    probabilities = np.full((len(xyz), len(SCHEME)), 0.02, np.float32)
    probabilities[:, 1], probabilities[len(mast) :, 1], probabilities[len(mast) :, 2] = 0.9, 0.72, 0.2
    evidence = ClassEvidence(probabilities, np.arange(len(xyz)), group_shares(SCHEME))
    found = extract_objects(
        xyz, np.ones(len(xyz), np.int64), np.ones(len(xyz)), classes=RULES, origin=UTM, height_above_ground=xyz[:, 2],
        evidence=evidence, classifier=Planted(),
    )  # fmt: skip
    merged = merge_scenes([found], classes=RULES, classifier=Planted())
    of_plate = merged.objects[merged.objects["y"] < UTM[1] + 3.9]
    assert len(merged.objects) == 2 and of_plate["point_count"].tolist() == [len(plate)]
    assert merged.objects["height"].max() > 7.8


def test_the_least_score_may_differ_by_kind():
    whole, _ = cut_and_merged(cuts=(20.0,))
    listed, _ = cut_and_merged(cuts=(20.0,), least_score={"pole": 1.0, "sign": 0.0, "vehicle": 0.0, "tree": 0.0})
    expected = whole[(whole["kind"] != "pole") | (whole["score"] >= 1.0)]
    assert listed["kind"].tolist() == expected["kind"].tolist() and len(listed) < len(whole)


def test_a_survey_without_objects_has_an_empty_inventory():
    flat = np.random.default_rng(0).random((500, 3)) * [8, 8, 0.02]
    piece = extract_objects(flat, np.zeros(500, int), np.ones(500), classes=RULES)
    merged = merge_scenes([piece], classes=RULES, classifier=Planted(), least_score=dict.fromkeys(KINDS, 0.4))
    assert not len(merged.objects) and not merged.numbers[piece.scene][piece.part].any()


def stump(feature, n_features, low, high):
    """Return a tree with one node: `low` where a feature is at most 0.5, else `high`."""
    return BoostedTrees(
        np.array([2], np.uint8), np.array([0], np.uint8), np.array([feature], np.int16), np.array([0.5], np.float32),
        np.array([True]), np.array([-1], np.int8), np.array([-2], np.int8), np.array([low, high], np.float32),
        np.zeros(1), n_features,
    )  # fmt: skip


def test_classifier_answers_names_reasons_and_is_stored():
    names = ("own sign", "beside tree", "panel_width")
    classifier = ObjectClassifier(
        {"sign": names}, {"sign": stump(0, 3, -2.0, 2.0)}, {"sign": (0.5, 0.1)}, {"sign": np.zeros(3, np.float32)}
    )
    features = np.array([[1.0, 0.0, 0.6], [0.0, 1.0, np.nan]], np.float32)
    again = ObjectClassifier.from_arrays(classifier.to_arrays())
    for one in (classifier, again):
        np.testing.assert_allclose(one.probabilities("sign", features)[:, 0], 1 / (1 + np.exp([-1.1, 0.9])))
        assert one.reasons("sign", features) == ["points classified as sign", ""]
    with pytest.raises(DataError, match="other features of 'sign'"):
        classifier.check_features("sign", names[:2])
    with pytest.raises(DataError, match="other features of 'pole'"):
        classifier.check_features("pole", names)
    with pytest.raises(DataError, match="lacks the array 'questions'"):
        ObjectClassifier.from_arrays({})


def test_every_feature_belongs_to_one_reason():
    for kind in KINDS:
        for name in FEATURES:
            owners = [text for text, _, starts in REASONS[kind] if name.startswith(starts)]
            assert len(owners) <= 1, (kind, name, owners)


def test_objects_far_from_the_path_are_not_listed_and_their_points_have_no_number():
    path = Trajectory.from_positions(UTM + [[0.0, 0, 0], [40, 0, 0]])
    every, of_points = cut_and_merged(cuts=(20.0,), trajectory=path)
    near, of_near = cut_and_merged(cuts=(20.0,), trajectory=path, within=6.0)
    assert {"tree"} == set(every["kind"]) - set(near["kind"]) and (near["offset"].abs() <= 6).all()
    assert (every["kind"] != "tree").sum() == len(near) and (near["object_id"] == range(1, len(near) + 1)).all()
    trees = of_points[1:][(every["kind"] == "tree").to_numpy()].sum()
    assert trees > 0 and of_near[0] == of_points[0] + trees and of_near.sum() == of_points.sum()
