"""The rival detectors: their kernels against slow versions, planted objects found, bad input."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from sklearn.tree import DecisionTreeClassifier

from mlsroad_pipeline.algorithms.baselines import bottom_up_top_down, hough_forest, object_matching
from mlsroad_pipeline.algorithms.baselines._hough_trees import N_DIRECTIONS, grow_tree
from mlsroad_pipeline.algorithms.baselines._surface_kernels import nearest_images, spread_evenly
from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down import BottomUpTopDownParameters, overlaps
from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down_training import train_bottom_up_top_down
from mlsroad_pipeline.algorithms.baselines.hough_forest import (
    HoughForest,
    HoughForestParameters,
    offsets_to_centre,
)
from mlsroad_pipeline.algorithms.baselines.hough_forest_training import fit_hough_forest, train_hough_forest
from mlsroad_pipeline.algorithms.baselines.object_matching import (
    ObjectMatchingParameters,
    affine_combinations,
    likeness,
)
from mlsroad_pipeline.algorithms.baselines.object_matching_training import train_object_matching
from mlsroad_pipeline.algorithms.baselines.object_parts import describe_parts, relative_centres
from mlsroad_pipeline.algorithms.baselines.oriented_points import OrientedPointParameters, describe_surfaces
from mlsroad_pipeline.algorithms.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.detection import DetectionParameters
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.model_bundle import label_cloud
from mlsroad_pipeline.algorithms.object_detector_training import select_objects
from mlsroad_pipeline.algorithms.object_detectors import DetectionStages, object_bounds
from mlsroad_pipeline.algorithms.object_segmentation import SegmentationParameters
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters
from tests.references_detectors import peak_of_circles

SCHEME = ClassScheme(
    "test", ("pole", "car", "other"), (("light_pole",), ("car",), ("tree",)), ("unlabelled",), (64, 66, 1)
)
WANTED = DetectionParameters(scheme="test", classes=("pole", "car"), min_points=5)
STAGES = DetectionStages(
    GroundParameters(), SegmentationParameters("euclidean", NormalizedCutParameters(tolerance=0.6))
)
FOREST = HoughForestParameters(n_trees=8)
MATCHING = ObjectMatchingParameters(candidates=4, n_turns=6)
SURFACES = OrientedPointParameters(voxel_size=0.15, max_points=30)
DESCRIPTORS = BottomUpTopDownParameters(surfaces=SURFACES, candidates=4, max_images=300)
METHODS = {
    "hough_forest": (hough_forest, train_hough_forest, FOREST),
    "object_matching": (object_matching, train_object_matching, MATCHING),
    "bottom_up_top_down": (bottom_up_top_down, train_bottom_up_top_down, DESCRIPTORS),
}
methods = pytest.mark.parametrize("slug", METHODS)


def pole(rng):
    height = rng.uniform(5, 7)
    mast = np.column_stack([rng.normal(0, 0.05, (150, 2)), rng.uniform(0.1, height, 150)])
    arm = np.column_stack([rng.uniform(0, 1.5, 60), rng.normal(0, 0.04, 60), np.full(60, height)])
    return np.concatenate([mast, arm]), 0.6


def car(rng):
    size = np.array([4.2, 1.8, 1.4]) * rng.uniform(0.9, 1.1)
    side = rng.integers(0, 3, 500)
    points = rng.uniform(-0.5, 0.5, (500, 3))
    points[side == 0, 2] = 0.5
    points[side == 1, 1] = np.sign(points[side == 1, 1]) * 0.5
    points[side == 2, 0] = np.sign(points[side == 2, 0]) * 0.5
    return points * size + [0, 0, 0.9], 0.3


def bush(rng):
    return rng.normal(0, 0.5, (400, 3)) * rng.uniform(0.7, 1.3, 3) + [0, 0, 1.6], 0.1


def street(rng, n=6, *, intensity=True):
    """Poles, cars and bushes in a row, each turned at random; no ground."""
    parts, labels, values = [], [], []
    for place in range(3 * n):
        points, bright = (pole, car, bush)[place % 3](rng)
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        points[:, :2] = points[:, :2] @ turn.T + [8.0 * place, rng.uniform(-2, 2)]
        parts.append(points)
        labels += [TAXONOMY[("light_pole", "car", "tree")[place % 3]]] * len(points)
        values += list(rng.normal(bright, 0.05, len(points)))
    xyz = np.concatenate(parts)
    numbers = np.repeat(np.arange(3 * n), [len(p) for p in parts]).astype(np.int32)
    columns = {"label": np.array(labels, np.uint8), "core": np.ones(len(xyz), bool)}
    if intensity:
        columns["intensity"] = np.clip(values, 0, 1).astype(np.float32)
    return PointCloud(xyz, columns), {"objects": numbers}


def described(slug, scene, objects):
    if slug == "bottom_up_top_down":
        return describe_surfaces(scene, objects, parameters=SURFACES)
    return describe_parts(scene, objects, parameters=METHODS[slug][2].regions)


def trained(slug, scene, objects, labels):
    own = np.ones(len(labels), bool)
    return METHODS[slug][1](
        {"train.a": described(slug, scene, objects)}, {"train.a": {"label": labels, "own": own}},
        parameters=METHODS[slug][2], stages=STAGES, detection=WANTED, scheme=SCHEME, trained_on={},
    )  # fmt: skip


LABELS = np.array([0, 1, -1], np.int16)


@pytest.fixture(scope="module")
def models():
    """One model of each method, learned from the same street."""
    scene, objects = street(np.random.default_rng(1), 8)
    return {slug: trained(slug, scene, objects, np.tile(LABELS, 8)) for slug in METHODS}


@methods
@pytest.mark.parametrize("intensity", [True, False])
def test_planted_objects_are_found_however_they_are_turned(slug, intensity, models, rng):
    scene, objects = street(rng, 5, intensity=intensity)
    found = METHODS[slug][0].detect_scene(described(slug, scene, objects), models[slug])
    assert (found["label"] == np.tile(LABELS, 5)).mean() >= 14 / 15
    assert found["label"].dtype == np.int16 and found["scores"].dtype == np.float32
    assert found["scores"].shape == (15, 2) and np.isfinite(found["scores"]).all()
    chosen = found["label"] >= 0
    rows = np.flatnonzero(chosen)
    np.testing.assert_array_equal(found["score"][chosen], found["scores"][rows, found["label"][chosen]])
    assert (found["score"][~chosen] == 0).all()


@methods
def test_same_seed_same_model_and_moved_scene_same_scores(slug, models, rng):
    scene, objects = street(np.random.default_rng(1), 8)
    again = trained(slug, scene, objects, np.tile(LABELS, 8))
    for name, values in models[slug].arrays.items():
        assert again.arrays[name].tobytes() == values.tobytes(), name
    parts = described(slug, scene, objects)
    moved = {**parts, "centres": parts["centres"] + [389_300.0, 5_819_700.0, 34.0]}
    one, other = (METHODS[slug][0].detect_scene(found, again) for found in (parts, moved))
    np.testing.assert_allclose(one["scores"], other["scores"], atol=0.03)


@methods
def test_raw_points_are_labelled(slug, models, rng):
    scene, _ = street(rng, 3)
    road = np.column_stack([rng.uniform(-5, 75, 5000), rng.uniform(-5, 5, 5000), np.zeros(5000)])
    columns = {
        "intensity": np.concatenate([scene["intensity"], np.full(len(road), 0.2, np.float32)]),
        "ground": np.arange(len(scene) + len(road)) >= len(scene),
    }
    cloud = PointCloud(np.concatenate([scene.xyz, road]), columns)
    labels, confidence = label_cloud(models[slug], cloud)
    assert (labels[len(scene) :] == -1).all()
    cars = np.flatnonzero(scene["label"] == TAXONOMY["car"])
    assert (labels[cars] == 1).mean() > 0.5 and (confidence[labels >= 0] > 0).all()
    empty = label_cloud(models[slug], PointCloud(np.zeros((0, 3))))
    assert len(empty[0]) == len(empty[1]) == 0


@methods
def test_tiny_objects_are_nothing_and_an_empty_scene_has_none(slug, models, rng):
    scene = PointCloud(rng.random((3, 3)), {"intensity": np.ones(3, np.float32)})
    found = METHODS[slug][0].detect_scene(described(slug, scene, {"objects": np.zeros(3, np.int32)}), models[slug])
    assert found["scores"].shape == (1, 2) and np.isfinite(found["scores"]).all() and found["label"][0] == -1
    nothing = described(slug, scene, {"objects": np.full(3, -1, np.int32)})
    assert METHODS[slug][0].detect_scene(nothing, models[slug])["scores"].shape == (0, 2)


@methods
def test_one_example_is_enough_to_train_and_none_is_never_detected(slug, rng, caplog):
    scene, objects = street(rng, 2)
    labels = np.array([0, -1, -1, -1, 1, -1], np.int16)
    model = trained(slug, scene, objects, labels)
    found = METHODS[slug][0].detect_scene(described(slug, scene, objects), model)
    assert np.isfinite(found["scores"]).all()
    without = trained(slug, scene, objects, np.where(labels == 1, -1, labels).astype(np.int16))
    assert "No training object is a car" in caplog.text
    found = METHODS[slug][0].detect_scene(described(slug, scene, objects), without)
    assert (found["scores"][:, 1] == 0).all() and (found["label"] != 1).all()
    with pytest.raises(DataError, match="no training scenes"):
        METHODS[slug][1](
            {}, {}, parameters=METHODS[slug][2], stages=STAGES, detection=WANTED, scheme=SCHEME, trained_on={}
        )


def test_peak_is_that_of_circles_drawn_one_by_one(rng):
    centres = rng.uniform(0, [4, 2, 1.5], (12, 3))
    votes = np.column_stack([rng.uniform(0, 2, 12), rng.uniform(-0.5, 0.5, 12)]).astype(np.float32)
    shares = rng.random((12, 1)).astype(np.float32)
    # A tree that tells twelve parts apart by their first feature: a chain of tests, every leaf with one vote.
    order = np.arange(12)
    tree = DecisionTreeClassifier(random_state=0).fit(order[:, None], order).tree_
    left = np.where(tree.children_left < 0, tree.value[:, 0].argmax(axis=1), 0).astype(np.int32)
    feature, threshold, child = _siblings(tree, left)
    arrays = {
        "roots": np.array([0, len(feature)]), "feature": feature, "threshold": threshold, "left": child,
        "leaf_roots": np.array([0, 12]), "shares": shares, "vote_starts": np.arange(13), "votes": votes,
        "cells": np.array([0.2, 0.5]),
    }  # fmt: skip
    parts = {
        "descriptors": np.zeros((12, 20), np.float32), "orientations": np.zeros((12, 3), np.float32),
        "centres": centres, "objects": np.zeros(12, np.int32), "n_objects": np.array(1), "intensity": np.array(True),
    }  # fmt: skip
    parts["descriptors"][:, 0] = order
    found = HoughForest(arrays, np.zeros(1), np.zeros(1), True).peaks(parts)
    wanted = peak_of_circles(centres, votes[:, 0], votes[:, 1], shares[:, 0], 0.2, 0.5, N_DIRECTIONS)
    np.testing.assert_allclose(found, [[wanted]], rtol=1e-6)


def _siblings(tree, leaves):
    """Lay a scikit-learn tree out with siblings side by side."""
    order, at = [0], 0
    while at < len(order):
        if tree.children_left[order[at]] >= 0:
            order += [tree.children_left[order[at]], tree.children_right[order[at]]]
        at += 1
    place = np.argsort(order)
    order = np.array(order)
    inner = tree.children_left[order] >= 0
    child = np.where(inner, place[tree.children_left[order]], leaves[order]).astype(np.int32)
    return np.where(inner, 0, -1).astype(np.int16), tree.threshold[order].astype(np.float32), child


def test_trees_part_what_can_be_parted(rng):
    features = rng.random((400, 5)).astype(np.float32)
    labels = (features[:, 2] > 0.5).astype(np.int16)
    offsets = np.column_stack([np.where(features[:, 4] > 0.3, 2.0, 1.0), np.zeros(400)])
    rows = np.arange(400)
    feature, threshold, left, starts, by_leaf = grow_tree(
        features, labels, offsets, np.ones(400), rows, 2, 12, 2, 60, np.random.default_rng(0)
    )
    assert sorted(by_leaf.tolist()) == rows.tolist() and (np.diff(starts) >= 2).all()
    leaf = np.empty(400, int)
    for row in range(400):
        node = 0
        while feature[node] >= 0:
            node = left[node] + int(features[row, feature[node]] > threshold[node])
        leaf[row] = left[node]
    np.testing.assert_array_equal(leaf[by_leaf], np.repeat(np.arange(len(starts) - 1), np.diff(starts)))
    share = np.bincount(leaf, labels) / np.bincount(leaf)
    assert (np.minimum(share, 1 - share) * np.bincount(leaf)).sum() < 12  # nearly pure
    spread = [
        np.ptp(offsets[(leaf == k) & (labels == 0), 0]) for k in range(leaf.max() + 1) if (labels[leaf == k] == 0).any()
    ]
    assert np.mean(np.array(spread) == 0) > 0.8


def test_offsets_do_not_know_the_way_an_object_is_turned(rng):
    scene, objects = street(rng, 1)
    parts = described("hough_forest", scene, objects)
    quarter = {**parts, "centres": parts["centres"] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])}
    np.testing.assert_allclose(offsets_to_centre(parts), offsets_to_centre(quarter), atol=1e-9)


def test_parts_are_affine_combinations_of_their_neighbours(rng):
    centres = rng.normal(size=(30, 3))
    bounds = np.array([0, 20, 29, 30])
    around, weights = affine_combinations(centres, bounds, 6)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    first = np.repeat(bounds[:-1], np.diff(bounds))
    rebuilt = np.einsum("gk,gka->ga", weights, centres[first[:, None] + around])
    assert np.abs(rebuilt - centres)[:29].max() < 0.5 * np.abs(centres).max()
    turn = rng.normal(size=(3, 3))
    again = np.einsum("gk,gka->ga", weights, (centres @ turn.T + 5.0)[first[:, None] + around])
    np.testing.assert_allclose(again, rebuilt @ turn.T + 5.0, atol=1e-9)  # whatever affine map moves all of them


def test_an_object_is_most_like_itself(rng):
    scene, objects = street(rng, 3)
    parts = described("object_matching", scene, objects)
    geometry = np.array([0.5, 1.0, 0.4, 6, 6, 2, 0.2])
    found = likeness(parts, parts, geometry, intensity=True)
    np.testing.assert_allclose(np.diag(found), 1.0, atol=1e-6)
    assert found.min() >= 0 and found.max() <= 1 + 1e-9
    assert (found.argmax(axis=0) == np.arange(9)).all()
    assert found.tobytes() == likeness(parts, parts, geometry, intensity=True, n_threads=2).tobytes()
    pairs = found[np.ix_([0, 3, 6], [0, 3, 6])], found[np.ix_([0, 3, 6], [1, 4, 7])]
    assert pairs[0].min() > pairs[1].max()  # a pole is more like a pole than like a car


def test_overlap_is_one_with_itself_and_does_not_mind_a_turn(rng):
    scene, objects = street(rng, 2)
    parts = described("bottom_up_top_down", scene, objects)
    geometry = np.array([0.5, 2, 36, 5])
    every = np.ones((6, 6), bool)
    found = overlaps(parts, parts, geometry, wanted=every)
    np.testing.assert_allclose(np.diag(found), 1.0)
    c, s = np.cos(np.radians(40)), np.sin(np.radians(40))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = {**parts, "centres": parts["centres"] @ turn.T, "normals": parts["normals"] @ turn.T}
    back = overlaps(turned, parts, geometry, wanted=every)
    np.testing.assert_allclose(np.diag(back), 1.0, atol=0.02)
    assert (overlaps(parts, parts, geometry, wanted=~every) == 0).all()


def test_points_are_spread_evenly(rng):
    points = rng.random((300, 3))
    chosen = spread_evenly(points, np.array([0, 250, 300]), 40)
    assert chosen[:250].sum() == 40 and chosen[250:].sum() == 40
    kept = points[:250][chosen[:250]]
    assert chosen[np.argmin(points[:250, 2])]
    closest = cKDTree(kept).query(kept, k=2)[0][:, 1].min()
    farthest = cKDTree(kept).query(points[:250])[0].max()
    assert farthest <= closest + 1e-12  # no point left out is farther from the chosen than these from each other


def test_nearest_images_are_those_of_brute_force(rng):
    images, database = rng.random((40, 153)).astype(np.float32), rng.random((90, 153)).astype(np.float32)
    owner, theirs = rng.integers(0, 5, 40).astype(np.int32), rng.integers(-1, 5, 90).astype(np.int32)
    found = np.empty(40, np.int32)
    nearest_images(images, owner, database, theirs, found, 0, 40)
    away = ((images[:, None] - database[None]) ** 2).sum(axis=2)
    away[owner[:, None] == theirs[None]] = np.inf
    np.testing.assert_array_equal(found, away.argmin(axis=1))
    nearest_images(images[:1], np.zeros(1, np.int32), database, np.zeros(90, np.int32), found, 0, 1)
    assert found[0] == -1


def test_centres_are_taken_from_foot_and_middle(rng):
    scene, objects = street(rng, 1)
    parts = described("object_matching", scene, objects)
    relative = relative_centres(parts)
    for first, last in zip(object_bounds(parts)[:-1], object_bounds(parts)[1:], strict=True):
        np.testing.assert_allclose(relative[first:last, :2].mean(axis=0), 0, atol=1e-9)
        assert relative[first:last, 2].min() == 0
    one = select_objects(parts, np.array([1]))
    assert int(one["n_objects"]) == 1 and (one["objects"] == 0).all()


def test_bad_parameters_are_named():
    with pytest.raises(ParameterError, match="hough_forest.n_trees must be at least 1, got 0"):
        HoughForestParameters(n_trees=0)
    with pytest.raises(ParameterError, match="hough_forest.cell must be a finite number > 0, got 0"):
        HoughForestParameters(cell=0)
    with pytest.raises(ParameterError, match="object_matching.feature_share must be between 0 and 1, got 2"):
        ObjectMatchingParameters(feature_share=2)
    with pytest.raises(ParameterError, match="bottom_up_top_down.max_models must be at least 1, got 0"):
        BottomUpTopDownParameters(max_models=0)
    with pytest.raises(ParameterError, match="n_radial must be at least 2, got 1"):
        OrientedPointParameters(n_radial=1)
    with pytest.raises(DataError, match="arrays of a Hough forest lack roots"):
        HoughForest.from_arrays({}, intensity=True)


def test_forest_without_intensity_never_saw_it(rng):
    scene, objects = street(rng, 3)
    parts = described("hough_forest", scene, objects)
    labels = np.tile(LABELS, 3)
    one = fit_hough_forest(parts, labels, False, parameters=FOREST, n_classes=2)[0]
    bright = {**parts, "descriptors": parts["descriptors"].copy()}
    bright["descriptors"][:, 19] = rng.random(len(bright["descriptors"]))
    other = fit_hough_forest(bright, labels, False, parameters=FOREST, n_classes=2)[0]
    for name, values in one.to_arrays().items():
        assert values.tobytes() == other.to_arrays()[name].tobytes(), name
