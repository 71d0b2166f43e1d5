"""Training of the Hough forest."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.papers.shared.detection.sampling import TrainingObjects
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold
from mlsroad_pipeline.papers.shared.detection.training import train_object_detector
from mlsroad_pipeline.papers.shared.detection.types import Description, object_bounds
from mlsroad_pipeline.papers.yu2016.hough_forest._trees import grow_tree
from mlsroad_pipeline.papers.yu2016.hough_forest.detector import (
    SLUG,
    HoughForest,
    HoughForestParameters,
    offsets_to_centre,
    part_features,
)


def fit_hough_forest(objects: TrainingObjects, parameters: HoughForestParameters) -> tuple[HoughForest, dict[str, Any]]:
    """Grow a forest, and choose exponents and thresholds by out-of-bag votes."""
    p = parameters
    parts, labels, n_classes, intensity, weights, n_threads = objects
    rng = np.random.default_rng(p.seed)
    drawn, sample, truth = objects.sample(p)
    kinds = np.where(truth < 0, n_classes, truth).astype(np.int16)
    # Bootstrap samples contain whole objects: parts of one object are too similar to be independent.
    seen = np.zeros((p.n_trees, len(drawn)), dtype=np.bool_)
    columns = (part_features(sample, intensity=intensity), kinds[sample["objects"]], offsets_to_centre(sample))
    place = rng.permutation(len(sample["objects"]))
    trees = []
    for t in range(p.n_trees):
        for kind in np.unique(kinds):
            mine = np.flatnonzero(kinds == kind)
            seen[t, rng.choice(mine, len(mine))] = True
        rows = _rows_of(sample, seen[t], place, p.max_parts)
        trees.append(_tree(columns, rows, n_classes, p, rng))
    forest = HoughForest(_joined(trees, p), np.zeros(n_classes), np.zeros(n_classes), intensity)
    # Thresholds are chosen on all objects, see `TrainingObjects.sample`.
    unseen = np.ones((p.n_trees, len(labels)), dtype=np.bool_)
    unseen[:, drawn] = ~seen
    peaks = forest.peaks(parts, unseen, n_threads=n_threads)
    n_parts = np.maximum(np.diff(object_bounds(parts)), 1)
    return _with_thresholds(forest, peaks, n_parts, labels, weights, p)


def _rows_of(sample: Description, seen: NDArray[np.bool_], place: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return up to `most` parts of each object of a bootstrap sample, the first of a fixed random order."""
    order = np.lexsort((place, sample["objects"]))
    rank = np.arange(len(order)) - object_bounds(sample)[sample["objects"][order]]
    return np.sort(order[(rank < most) & seen[sample["objects"][order]]])


def _tree(
    columns: tuple[NDArray, NDArray, NDArray],
    rows: NDArray[np.int64],
    n: int,
    p: HoughForestParameters,
    rng: np.random.Generator,
) -> dict[str, NDArray]:
    """Grow a tree, and store the class shares and votes of its leaves."""
    features, labels, offsets = columns
    counts = np.bincount(labels[rows], minlength=n + 1)
    weights = (1.0 / np.maximum(counts, 1))[labels] * len(rows)  # all classes have equal weight
    grown = grow_tree(features, labels, offsets, weights, rows, n + 1, p.max_depth, p.min_parts, p.n_tests, rng)
    feature, threshold, left, starts, by_leaf = grown
    shares = np.zeros((len(starts) - 1, n + 1))
    leaf = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    np.add.at(shares, (leaf, labels[by_leaf]), weights[by_leaf])
    total = shares.sum(axis=1, keepdims=True)
    shares /= np.where(total > 0, total, 1.0)  # a tree without training parts has one empty leaf
    keep = labels[by_leaf] < n
    leaf, by_leaf = leaf[keep], by_leaf[keep]
    order = np.lexsort((offsets[by_leaf, 1], offsets[by_leaf, 0], labels[by_leaf], leaf))
    cell = leaf[order] * n + labels[by_leaf[order]]
    first = np.searchsorted(cell, np.arange(len(shares) * n + 1))
    size = np.diff(first)[cell]
    # Thin the votes of a leaf evenly to `n_votes`.
    rank = np.arange(len(cell)) - first[cell]
    kept = (size <= p.n_votes) | ((rank + 1) * p.n_votes // size > rank * p.n_votes // size)
    starts_kept = np.concatenate([[0], np.cumsum(np.bincount(cell[kept], minlength=len(shares) * n))])
    return {
        "feature": feature, "threshold": threshold, "left": left, "shares": shares[:, :n].astype(np.float32),
        "votes": offsets[by_leaf[order[kept]]].astype(np.float32), "vote_starts": starts_kept,
    }  # fmt: skip


def _joined(trees: list[dict[str, NDArray]], p: HoughForestParameters) -> dict[str, NDArray]:
    """Concatenate the arrays of trees."""
    joined = {name: np.concatenate([t[name] for t in trees]) for name in ("feature", "threshold", "left", "shares")}
    joined["votes"] = np.concatenate([t["votes"] for t in trees])
    joined["roots"] = np.cumsum([0, *(len(t["feature"]) for t in trees)])
    joined["leaf_roots"] = np.cumsum([0, *(len(t["shares"]) for t in trees)])
    sizes = np.concatenate([np.diff(t["vote_starts"]) for t in trees])
    joined["vote_starts"] = np.concatenate([[0], np.cumsum(sizes)])
    joined["cells"] = np.array([p.cell, p.height_cell])
    return joined


def _with_thresholds(
    forest: HoughForest,
    peaks: NDArray,
    n_parts: NDArray,
    labels: NDArray,
    weights: NDArray[np.float64] | None,
    p: HoughForestParameters,
) -> tuple[HoughForest, dict[str, Any]]:
    """Choose exponent and threshold of each class by the F-score."""
    exponents, thresholds, reached = [], [], []
    for k in range(len(forest.thresholds)):
        trials = [
            (*best_threshold((peaks[:, k] / n_parts**e).astype(np.float32), labels == k, weights), e)
            for e in p.exponents
        ]
        f_score, threshold, exponent = trials[int(np.argmax([trial[0] for trial in trials]))]
        reached.append(f_score)
        thresholds.append(threshold)
        exponents.append(exponent)
    done = HoughForest(forest.arrays, np.array(exponents), np.array(thresholds), forest.intensity)
    return done, {"leaves": len(forest.arrays["shares"]), "f_scores": reached, "exponents": exponents}


train_hough_forest = partial(train_object_detector, fit=fit_hough_forest, slug=SLUG, uses_intensity=True)
"""Trains a model of this method, see `train_object_detector`."""
