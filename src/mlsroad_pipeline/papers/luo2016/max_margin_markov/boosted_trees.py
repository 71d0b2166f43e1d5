"""Boosted regression trees with one value per class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from numba import njit
from numpy.typing import NDArray
from sklearn.tree import DecisionTreeRegressor

from mlsroad_pipeline.algorithms.core.validation import check_tested


@njit(cache=True, nogil=True)
def _add_trees(
    features: NDArray[np.float32],
    roots: NDArray[np.int64],
    column: NDArray[np.int16],
    threshold: NDArray[np.float64],
    child: NDArray[np.int32],
    value: NDArray[np.float32],
    total: NDArray[np.float64],
) -> None:
    for tree in range(len(roots) - 1):
        for row in range(len(features)):
            node = roots[tree]
            while column[node] >= 0:
                right = features[row, column[node]] > threshold[node]
                node = roots[tree] + child[node, np.int64(right)]
            for k in range(total.shape[1]):
                total[row, k] += value[node, k]


class BoostedTrees:
    """Sum of regression trees, initially zero."""

    def __init__(self, n_values: int) -> None:
        self.n_values = n_values
        self._roots = np.zeros(1, np.int64)
        self._column = np.zeros(0, np.int16)
        self._threshold = np.zeros(0, np.float64)
        self._child = np.zeros((0, 2), np.int32)
        self._value = np.zeros((0, n_values), np.float32)

    def __len__(self) -> int:
        """Return the number of trees."""
        return len(self._roots) - 1

    def grow(
        self,
        features: NDArray[np.float32],
        target: NDArray[np.floating],
        weight: NDArray[np.floating],
        *,
        step: float,
        max_depth: int,
        min_samples_leaf: int,
        seed: int,
    ) -> None:
        """Fit a tree to a functional gradient by weighted least squares and add it."""
        if len(features) == 0 or not target.any():
            return
        fitted = DecisionTreeRegressor(
            max_depth=max_depth, min_samples_leaf=min(min_samples_leaf, len(features)), random_state=seed
        ).fit(features, target, sample_weight=weight)
        tree = fitted.tree_
        self._roots = np.append(self._roots, self._roots[-1] + tree.node_count)
        self._column = np.append(self._column, np.where(tree.children_left < 0, -1, tree.feature).astype(np.int16))
        self._threshold = np.append(self._threshold, tree.threshold)
        children = np.stack([tree.children_left, tree.children_right], axis=1).astype(np.int32)
        self._child = np.concatenate([self._child, children])
        values = step * tree.value.reshape(tree.node_count, self.n_values)
        self._value = np.concatenate([self._value, values.astype(np.float32)])

    def predict(self, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the sum of the trees."""
        check_tested(self._column, features.shape[1], "boosted trees")
        total = np.zeros((len(features), self.n_values))
        rows = np.ascontiguousarray(features, dtype=np.float32)
        _add_trees(rows, self._roots, self._column, self._threshold, self._child, self._value, total)
        return total

    def to_arrays(self, prefix: str) -> dict[str, NDArray]:
        """Return the trees as named arrays."""
        return {
            f"{prefix}_roots": self._roots,
            f"{prefix}_column": self._column,
            f"{prefix}_threshold": self._threshold,
            f"{prefix}_child": self._child,
            f"{prefix}_value": self._value,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], prefix: str) -> Self:
        """Rebuild the trees from the arrays of `to_arrays`."""
        trees = cls(arrays[f"{prefix}_value"].shape[1])
        trees._roots, trees._column = arrays[f"{prefix}_roots"], arrays[f"{prefix}_column"]
        trees._threshold, trees._child = arrays[f"{prefix}_threshold"], arrays[f"{prefix}_child"]
        trees._value = arrays[f"{prefix}_value"]
        return trees
