"""Kernels of the baseline detectors against slow implementations."""

import numpy as np
from helpers.planted import described, street
from references.detectors import peak_of_circles
from scipy.spatial import cKDTree
from sklearn.tree import DecisionTreeClassifier

from mlsroad_pipeline.papers.shared.detection.regions import relative_centres
from mlsroad_pipeline.papers.shared.detection.training import select_objects
from mlsroad_pipeline.papers.shared.detection.types import object_bounds
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.detector import overlaps
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.oriented_points import nearest_images, spread_evenly
from mlsroad_pipeline.papers.yu2016.hough_forest._trees import N_DIRECTIONS, grow_tree
from mlsroad_pipeline.papers.yu2016.hough_forest.detector import (
    HoughForest,
    offsets_to_centre,
)
from mlsroad_pipeline.papers.yu2016.object_matching.detector import (
    affine_combinations,
    object_similarity,
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


def test_trees_separate_separable_classes(rng):
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


def test_offsets_are_invariant_to_rotation(rng):
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
    found = object_similarity(parts, parts, geometry, intensity=True)
    np.testing.assert_allclose(np.diag(found), 1.0, atol=1e-6)
    assert found.min() >= 0 and found.max() <= 1 + 1e-9
    assert (found.argmax(axis=0) == np.arange(9)).all()
    assert found.tobytes() == object_similarity(parts, parts, geometry, intensity=True, n_threads=2).tobytes()
    pairs = found[np.ix_([0, 3, 6], [0, 3, 6])], found[np.ix_([0, 3, 6], [1, 4, 7])]
    assert pairs[0].min() > pairs[1].max()  # a pole is more like a pole than like a car


def test_overlap_with_itself_is_one_for_any_rotation(rng):
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
