"""Fast prediction of a fitted random forest from flat arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks

_ROWS = 32
"""Rows traversed in parallel, so that memory latency overlaps."""
_BLOCK = 8192
"""Rows of a block, which passes through all trees; large blocks amortise loading a tree into the cache."""
_STEPS = 4
"""Levels between two tests of whether all rows of a group have reached a leaf."""

# A node is packed into 64 bits, one load per step: 32 bits of threshold, 10 of column, 22 of child.
_COLUMN_SHIFT, _CHILD_SHIFT = 32, 42
_MAX_FEATURES, _MAX_NODES = 2**9, 2**22


@dataclass(frozen=True)
class FlatForest:
    """Trees of a fitted forest as flat arrays.

    A row goes to ``child`` if its feature is at most the threshold, else to ``child + 1``.
    """

    roots: NDArray[np.int64]  # First node of each tree; the nodes of a tree are contiguous, in breadth-first order
    feature: NDArray[np.int16]  # Column tested by a node; -1 for leaves
    # Largest float32 not above scikit-learn's float64 threshold; comparisons with float32 features are unchanged
    threshold: NDArray[np.float32]
    missing_left: NDArray[np.bool_]  # True if NaN goes to ``child``, else to ``child + 1``
    child: NDArray[np.int32]  # Left child, relative to the first node of the tree; for leaves the row of `leaf_values`
    leaf_values: NDArray[np.float32]  # Class probabilities of the leaves
    n_features: int  # Number of features

    def __post_init__(self) -> None:
        largest = int(np.diff(self.roots).max(initial=0))
        if largest > _MAX_NODES:
            raise DataError(f"a tree has {largest} nodes, more than {_MAX_NODES}: raise min_samples_leaf")
        if self.n_features > _MAX_FEATURES:
            raise DataError(f"the forest has {self.n_features} features, more than {_MAX_FEATURES}")
        self._check_nodes()
        rows = self.leaf_values
        if (
            rows.ndim != 2
            or not np.isfinite(rows).all()
            or (rows < 0).any()
            or (abs(rows.sum(axis=1) - 1) > 1e-3).any()
        ):
            raise DataError("the leaves of the forest hold no probabilities: the model is damaged")

    def _check_nodes(self) -> None:
        """Check that the kernels, which test no bounds, stay inside the arrays and come to an end."""
        sizes, m = np.diff(self.roots), len(self.feature)
        others = (self.threshold, self.missing_left, self.child)
        if len(self.roots) < 2 or self.roots[0] != 0 or self.roots[-1] != m or sizes.min() < 1:
            raise DataError("the trees of the forest do not cover its nodes: the model is damaged")
        if any(array.shape != (m,) for array in others) or np.isnan(self.threshold).any():
            raise DataError("the arrays of the forest have different sizes or NaN thresholds: the model is damaged")
        if not -1 <= self.feature.min() <= self.feature.max() < self.n_features:
            raise DataError(f"the forest tests a feature that is none of its {self.n_features}: the model is damaged")
        leaf = self.feature < 0
        own = np.arange(m) - np.repeat(self.roots[:-1], sizes)
        inside = (self.child > own) & (self.child < np.repeat(sizes, sizes) - 1)  # later nodes alone: no cycles
        known = (self.child >= 0) & (self.child < len(self.leaf_values))
        if not np.where(leaf, known, inside).all():
            node = int(np.argmin(np.where(leaf, known, inside)))
            raise DataError(f"node {node} of the forest points to {self.child[node]}, outside: the model is damaged")

    def __len__(self) -> int:
        """Return the number of trees."""
        return len(self.roots) - 1

    @classmethod
    def from_trees(cls, trees: Sequence[Any]) -> FlatForest:
        """Convert scikit-learn trees."""
        if not trees:
            raise DataError("a forest needs at least one tree, got none")
        parts = [_flatten(estimator.tree_) for estimator in trees]
        n_leaves = 0
        for part in parts:
            leaf = part["feature"] < 0
            part["child"][leaf] = n_leaves + np.arange(np.count_nonzero(leaf))
            n_leaves += int(np.count_nonzero(leaf))
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        arrays["roots"] = np.cumsum([0, *(len(part["feature"]) for part in parts)]).astype(np.int64)
        arrays["n_features"] = np.array(trees[0].n_features_in_)
        return cls.from_arrays(arrays)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the forest as named arrays, for an NPZ file."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> FlatForest:
        """Rebuild a forest from the arrays of `to_arrays`."""
        names = [field.name for field in fields(cls)]
        check_arrays(arrays, names, "a forest")
        own = {name: np.asarray(arrays[name]) for name in names}
        n_features = int(own.pop("n_features"))
        return cls(n_features=n_features, **own)

    @cached_property
    def _nodes(self) -> NDArray[np.uint64]:
        """Packed nodes; a leaf points to itself with a threshold that no value exceeds."""
        leaf = self.feature < 0
        own = np.arange(len(leaf)) - np.repeat(self.roots[:-1], np.diff(self.roots))
        threshold = np.where(leaf, np.int32(2**31 - 1), _sortable(self.threshold)).view(np.uint32).astype(np.uint64)
        column = np.where(leaf, 0, 2 * self.feature.astype(np.int64) + self.missing_left).astype(np.uint64)
        child = np.where(leaf, own, self.child).astype(np.uint64)
        return threshold | column << np.uint64(_COLUMN_SHIFT) | child << np.uint64(_CHILD_SHIFT)

    def predict_proba(self, values: ArrayLike, *, n_threads: int = 1) -> NDArray[np.float32]:
        """Return the mean class probabilities of the leaves that each row reaches."""
        features = np.ascontiguousarray(values, dtype=np.float32)
        if features.ndim != 2 or features.shape[1] != self.n_features:
            raise DataError(f"features must have shape (n, {self.n_features}), got {features.shape}")
        if np.isinf(features).any():
            raise DataError(f"features contain infinity in row {int(np.argwhere(np.isinf(features))[0, 0])}")
        out = np.empty((len(features), self.leaf_values.shape[1]), np.float32)
        nodes = self._nodes

        def walk(first: int, last: int) -> None:
            _walk_blocks(features, self.roots, nodes, self.child, self.leaf_values, out, first, last)

        run_in_chunks(walk, len(features), n_threads=n_threads)
        return out


def _flatten(tree: Any) -> dict[str, NDArray]:
    """Return the nodes of a tree in breadth-first order, siblings adjacent; the caller sets `child` of the leaves."""
    left, right = tree.children_left, tree.children_right
    level = np.array([0])
    levels = [level]
    while len(level):
        inner = level[left[level] >= 0]
        level = np.stack([left[inner], right[inner]], axis=1).ravel()
        levels.append(level)
    order = np.concatenate(levels)
    position = np.empty(len(order), np.int64)
    position[order] = np.arange(len(order))
    leaf = left[order] < 0
    exact = tree.threshold[order]
    threshold = exact.astype(np.float32)
    threshold = np.where(threshold > exact, np.nextafter(threshold, np.float32(-np.inf)), threshold)
    values = tree.value[order[leaf], 0]
    return {
        "feature": np.where(leaf, -1, tree.feature[order]).astype(np.int16),
        "threshold": np.where(leaf, np.float32(0), threshold),
        "missing_left": np.where(leaf, False, tree.missing_go_to_left[order].astype(bool)),
        "child": np.where(leaf, 0, position[left[order]]).astype(np.int32),
        "leaf_values": (values / values.sum(axis=1, keepdims=True)).astype(np.float32),
    }


def _sortable(values: NDArray[np.float32]) -> NDArray[np.int32]:
    """Map floats to integers of the same order, and -0 to 0."""
    bits = np.ascontiguousarray(values).view(np.int32)
    return np.where(bits < 0, np.int32(-(2**31)) - bits, bits).astype(np.int32)


@njit(cache=True, nogil=True)
def _encode(features: NDArray, codes: NDArray, first: int, last: int) -> None:
    """Write each feature twice as sortable integers, with NaN as the largest value first and the smallest second."""
    bits = features.view(np.int32)
    for i in range(first, last):
        for j in range(features.shape[1]):
            value = bits[i, j]
            code = np.int32(-(2**31)) - value if value < 0 else value
            missing = np.isnan(features[i, j])
            codes[i - first, 2 * j] = np.int32(2**31 - 1) if missing else code
            codes[i - first, 2 * j + 1] = np.int32(-(2**31)) if missing else code


@njit(cache=True, nogil=True)
def _walk_group(codes: NDArray, base: np.uint64, width: np.uint64, nodes: NDArray, at: NDArray, n: int) -> None:
    """Move n rows from the root to their leaves in lockstep; unsigned indices avoid tests for negative ones."""
    column_shift, child_shift = np.uint64(_COLUMN_SHIFT), np.uint64(_CHILD_SHIFT)
    column_mask = np.uint64(2 * _MAX_FEATURES - 1)
    at[:n] = np.uint64(0)
    walking = True
    while walking:
        moved = np.uint64(0)
        for step in range(_STEPS):
            for r in range(n):
                node = nodes[at[r]]
                code = codes[base + np.uint64(r) * width + ((node >> column_shift) & column_mask)]
                following = (node >> child_shift) + np.uint64(code > np.int32(node))
                if step == _STEPS - 1:
                    moved |= following ^ at[r]
                at[r] = following
        walking = moved != np.uint64(0)


@njit(cache=True, nogil=True)
def _walk_blocks(
    features: NDArray,
    roots: NDArray,
    nodes: NDArray,
    child: NDArray,
    leaf_values: NDArray,
    out: NDArray,
    first: int,
    last: int,
) -> None:
    n_trees, n_classes = len(roots) - 1, leaf_values.shape[1]
    width = np.uint64(2 * features.shape[1])
    codes = np.empty((min(_BLOCK, last - first), 2 * features.shape[1]), np.int32)
    flat = codes.reshape(-1)
    sums = np.empty((len(codes), n_classes))
    at = np.empty(_ROWS, np.uint64)
    for block in range(first, last, _BLOCK):
        n_block = min(_BLOCK, last - block)
        _encode(features, codes, block, block + n_block)
        sums[:n_block] = 0.0
        for tree in range(n_trees):
            tree_nodes = nodes[roots[tree] : roots[tree + 1]]
            tree_child = child[roots[tree] : roots[tree + 1]]
            for group in range(0, n_block, _ROWS):
                n_group = min(_ROWS, n_block - group)
                _walk_group(flat, np.uint64(group) * width, width, tree_nodes, at, n_group)
                for r in range(n_group):
                    leaf = tree_child[at[r]]
                    for c in range(n_classes):
                        sums[group + r, c] += leaf_values[leaf, c]
        for r in range(n_block):
            for c in range(n_classes):
                out[block + r, c] = sums[r, c] / n_trees
