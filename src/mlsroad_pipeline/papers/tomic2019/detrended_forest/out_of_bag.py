"""Out-of-bag error of a forest as a function of its number of trees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier


def out_of_bag_curves(
    model: RandomForestClassifier, values: NDArray[np.float32], target: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the out-of-bag error of the first 1, 2, ... trees, overall and averaged over classes."""
    n_trees = len(model.estimators_)
    votes = np.zeros((len(values), len(model.classes_)))
    per_class = np.bincount(target, minlength=votes.shape[1])
    curve, balanced = np.empty(n_trees), np.empty(n_trees)
    for at, (tree, drawn) in enumerate(zip(model.estimators_, model.estimators_samples_, strict=True)):
        left_out = np.ones(len(values), dtype=bool)
        left_out[drawn] = False
        leaves = tree.tree_.predict(np.ascontiguousarray(values[left_out]))
        votes[left_out] += leaves / leaves.sum(axis=1, keepdims=True)
        voted = votes.any(axis=1)
        wrong = voted & (votes.argmax(axis=1) != target)
        curve[at] = wrong.sum() / max(1, voted.sum())
        seen = np.bincount(target[voted], minlength=len(per_class))
        with np.errstate(invalid="ignore"):
            rates = np.bincount(target[wrong], minlength=len(per_class)) / seen
        balanced[at] = np.nanmean(rates) if seen.any() else np.nan
    return curve, balanced
