"""Fast prediction of gradient-boosted trees from flat arrays.

The leaf of a row follows from bit masks, as in QuickScorer (Lucchese et al. 2015): a node that sends the row to the
right excludes the leaves of its left subtree, and the first leaf that is left is the row's. No step branches, so that
a block of rows is processed by vector instructions. Features are compared as their numbers among the thresholds. Masks
are split into bytes, of which most nodes change one, as in RapidScorer (Ye et al. 2018).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks
from mlsroad_pipeline.algorithms.models.machines.boosted_kernels import LEAF_SLOTS, add_trees, order_leaves

_NAN_MISSING = 2
"""LightGBM's code of missing values that are NaN, in bits 2 and 3 of a decision type."""


class Fields:
    """Lines ``name=value`` of a part of a LightGBM model."""

    def __init__(self, text: str) -> None:
        self._values = dict(re.findall(r"^(\w+)=(.*)$", text, re.MULTILINE))

    def integer(self, name: str) -> int:
        """Return an integer."""
        return int(self.text(name))

    def numbers(self, name: str, kind: type) -> NDArray:
        """Return a list of numbers as an array of a type."""
        return np.array(self.text(name).split(), dtype=np.float64).astype(kind)

    def text(self, name: str) -> str:
        """Return a value as it stands; DataError if it is missing."""
        if name not in self._values:
            raise DataError(f"the LightGBM model has no {name!r}: it is damaged or of another version")
        return self._values[name]


def read_tree(lines: Fields) -> dict[str, NDArray]:
    """Return the arrays of one tree; thresholds are the largest float32 values not above LightGBM's."""
    if lines.integer("num_leaves") < 2:
        none = np.zeros(0, np.int64)
        leaf = lines.numbers("leaf_value", np.float64)[:1]
        return {"feature": none, "threshold": none, "missing_left": none, "left": none, "right": none, "leaf": leaf}
    decision = lines.numbers("decision_type", np.int64)
    if (decision & 1).any():
        raise DataError("the LightGBM model has categorical features: numerical ones alone are supported")
    exact = lines.numbers("threshold", np.float64)
    rounded = exact.astype(np.float32)
    is_nan_missing = decision >> 2 & 3 == _NAN_MISSING
    return {
        "feature": lines.numbers("split_feature", np.int64),
        "threshold": np.where(rounded > exact, np.nextafter(rounded, np.float32(-np.inf)), rounded),
        # LightGBM compares NaN as 0 where the training had none in this feature.
        "missing_left": np.where(is_nan_missing, (decision & 2) > 0, exact >= 0),
        "left": lines.numbers("left_child", np.int64),
        "right": lines.numbers("right_child", np.int64),
        "leaf": lines.numbers("leaf_value", np.float64),
    }


MAX_LEAVES, MAX_THRESHOLDS = 64, 254


class _Prepared(NamedTuple):
    """Arrays of the kernel."""

    thresholds: NDArray[np.float32]
    threshold_starts: NDArray[np.int64]
    part_starts: NDArray[np.int64]
    columns: NDArray[np.int16]
    codes: NDArray[np.uint8]
    octets: NDArray[np.uint8]
    masks: NDArray[np.uint8]
    leaves: NDArray[np.float32]


_DTYPES = {
    **{"n_leaves": np.uint8, "tree_class": np.uint8, "feature": np.int16, "threshold": np.float32},
    **{"missing_left": np.bool_, "left": np.int8, "right": np.int8, "leaf": np.float32},
    **{"initial": np.float64, "n_features": np.int64},
}
"""Types of the arrays of a stored model."""


@dataclass(frozen=True)
class BoostedTrees:
    """Trees whose leaf values are added per class.

    A row goes to the left child if its feature is at most the threshold, or if it is NaN and ``missing_left`` is true.
    """

    n_leaves: NDArray[np.uint8]  # Leaves of each tree, 1 to 64; a tree has one node less
    tree_class: NDArray[np.uint8]  # Class of each tree
    feature: NDArray[np.int16]  # Column that a node tests
    threshold: NDArray[np.float32]  # Threshold of a node
    missing_left: NDArray[np.bool_]  # Whether NaN goes to the left child
    left: NDArray[np.int8]  # Left child within the tree: a node, or ``-1 - leaf``
    right: NDArray[np.int8]  # Right child
    leaf: NDArray[np.float32]  # Values of the leaves, tree after tree
    initial: NDArray[np.float64]  # Scores before the first tree
    n_features: int  # Number of features

    def __post_init__(self) -> None:
        n_leaves = np.asarray(self.n_leaves, np.int64)
        if len(n_leaves) and not 1 <= n_leaves.min() <= n_leaves.max() <= MAX_LEAVES:
            raise DataError(f"trees must have 1 to {MAX_LEAVES} leaves, got {n_leaves.min()}..{n_leaves.max()}")
        nodes: list[NDArray] = [self.feature, self.threshold, self.missing_left, self.left, self.right]
        if {len(a) for a in nodes} != {int(n_leaves.sum()) - len(n_leaves)} or len(self.leaf) != n_leaves.sum():
            raise DataError("the arrays of the trees have different sizes: the model is damaged")
        if len(self.feature) and not 0 <= self.feature.min() <= self.feature.max() < self.n_features:
            raise DataError(f"a tree tests feature {self.feature.max()}, of {self.n_features} features")
        if len(self.tree_class) != len(n_leaves) or (len(n_leaves) and self.tree_class.max() >= len(self.initial)):
            raise DataError(f"the trees need one class each, below {len(self.initial)}")
        if not all(np.isfinite(a).all() for a in (self.leaf, self.initial)) or np.isnan(self.threshold).any():
            raise DataError("the trees have values that are NaN or infinite: the model is damaged")
        self._check_children(n_leaves)

    def _check_children(self, n_leaves: NDArray[np.int64]) -> None:
        """Check that each node but the first, and each leaf, is the child of one earlier node of its tree."""
        sizes = n_leaves - 1
        starts, leaf_starts = (np.cumsum(values) - values for values in (sizes, n_leaves))
        tree = np.repeat(np.arange(len(sizes)), sizes)
        children = np.stack([self.left, self.right], axis=1).astype(np.int64)
        own = np.arange(len(tree)) - starts[tree]
        to_leaf = children < 0
        later = (children > own[:, None]) & (children < sizes[tree, None])
        known = -1 - children < n_leaves[tree, None]
        if not np.where(to_leaf, known, later).all():
            node = int(np.argmin(np.where(to_leaf, known, later).all(axis=1)))
            raise DataError(f"tree {tree[node]}: node {own[node]} has a child that is none: the model is damaged")
        nodes = np.bincount((starts[tree, None] + children)[~to_leaf], minlength=len(tree))
        leaves = np.bincount((leaf_starts[tree, None] - 1 - children)[to_leaf], minlength=int(n_leaves.sum()))
        alone = np.repeat(sizes == 0, n_leaves)  # the leaf of a tree without nodes
        if (nodes != (own > 0)).any() or (leaves != ~alone).any():
            raise DataError("a node or leaf of the trees has several parents or none: the model is damaged")

    def __len__(self) -> int:
        """Return the number of trees."""
        return len(self.n_leaves)

    @classmethod
    def from_lightgbm(cls, text: str, *, initial: ArrayLike | None = None) -> BoostedTrees:
        """Convert a model of LightGBM."""
        header = Fields(text.split("\nTree=", 1)[0])
        n_classes = header.integer("num_tree_per_iteration")
        trees = [read_tree(Fields(part)) for part in text.split("\nTree=")[1:]]
        names = ("feature", "threshold", "missing_left", "left", "right", "leaf")
        kinds = (np.int16, np.float32, np.bool_, np.int8, np.int8, np.float32)
        arrays: dict[str, Any] = {
            name: np.concatenate([np.zeros(0, kind), *(tree[name] for tree in trees)]).astype(kind)
            for name, kind in zip(names, kinds, strict=True)
        }
        sizes = [len(tree["leaf"]) for tree in trees]
        if max(sizes, default=1) > MAX_LEAVES:
            raise DataError(f"a tree has {max(sizes)} leaves, more than {MAX_LEAVES}: lower num_leaves")
        return cls(
            n_leaves=np.array(sizes, np.uint8),
            tree_class=(np.arange(len(trees)) % n_classes).astype(np.uint8),
            initial=np.zeros(n_classes) if initial is None else np.asarray(initial, np.float64),
            n_features=header.integer("max_feature_idx") + 1,
            **arrays,
        )

    @classmethod
    def joined(cls, parts: Sequence[BoostedTrees]) -> BoostedTrees:
        """Join trees of the same features and classes; the first part gives the initial scores."""
        own = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)[:8]}
        return cls(initial=parts[0].initial, n_features=parts[0].n_features, **own)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trees as named arrays, for an NPZ file."""
        return {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> BoostedTrees:
        """Rebuild trees from the arrays of `to_arrays`."""
        names = [f.name for f in fields(cls)]
        check_arrays(arrays, names, "boosted trees")
        own = {name: np.asarray(arrays[name]) for name in names}
        for name, values in own.items():
            if values.dtype != _DTYPES[name] or values.ndim != (name != "n_features"):
                raise DataError(f"array {name} of boosted trees is {values.dtype} {values.shape}: the model is damaged")
        return cls(n_features=int(own.pop("n_features")), **own)

    @cached_property
    def _prepared(self) -> _Prepared:
        return _prepare(self)

    def scores(self, values: ArrayLike, *, n_threads: int = 1) -> NDArray[np.float64]:
        """Return the sums of the initial scores and the leaf values per class."""
        table = np.ascontiguousarray(values, dtype=np.float32)
        if table.ndim != 2 or table.shape[1] != self.n_features:
            raise DataError(f"features must have shape (n, {self.n_features}), got {table.shape}")
        out = np.empty((len(table), len(self.initial)))
        ready = self._prepared

        def run(first: int, last: int) -> None:
            add_trees(table, *ready, self.tree_class, self.initial, out, first, last)

        run_in_chunks(run, len(table), n_threads=n_threads)
        return out


def _prepare(trees: BoostedTrees) -> _Prepared:
    """Return codes of the thresholds, masks of the nodes, and leaf values by the hash of their bit."""
    of_feature = [np.unique(trees.threshold[trees.feature == f]) for f in range(trees.n_features)]
    sizes = np.array([len(values) for values in of_feature])
    if sizes.max(initial=0) > MAX_THRESHOLDS:
        raise DataError(f"a feature has {sizes.max()} thresholds, more than {MAX_THRESHOLDS}: lower max_bin")
    codes = np.zeros(len(trees.feature), np.uint8)
    for f, values in enumerate(of_feature):
        own = trees.feature == f
        codes[own] = np.searchsorted(values, trees.threshold[own])
    n_bytes = 4 if int(np.max(trees.n_leaves, initial=1)) <= 32 else 8
    n_leaves = trees.n_leaves.astype(np.int64)
    leaf_starts, node_starts = np.cumsum([0, *n_leaves]), np.cumsum([0, *(n_leaves - 1)])
    masks, ordered = np.zeros(len(trees.feature), "<u8"), np.zeros(len(trees.leaf), np.int64)
    order_leaves(trees.left, trees.right, node_starts, masks, ordered)
    excluded = np.ascontiguousarray(masks.view(np.uint8).reshape(-1, 8)[:, :n_bytes])
    leaves = np.zeros((len(trees), 8 * n_bytes), np.float32)
    tree = np.repeat(np.arange(len(trees)), n_leaves)
    leaves[tree, LEAF_SLOTS[np.arange(len(tree)) - leaf_starts[tree]]] = trees.leaf[leaf_starts[tree] + ordered]
    node, octet = np.nonzero(excluded)
    return _Prepared(
        np.concatenate([np.zeros(0, np.float32), *of_feature]),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        np.searchsorted(node, node_starts).astype(np.int64),
        (2 * trees.feature + ~trees.missing_left).astype(np.int16)[node],
        codes[node],
        octet.astype(np.uint8),
        ~excluded[node, octet],
        leaves,
    )


class ThresholdCodes:
    """Features as numbers among the thresholds of trees.

    The kernel of the prediction has room for a limited number of thresholds per feature, so that trees which are added
    again and again must not bring new ones. A feature that the trees do not test has one value.
    """

    def __init__(self, trees: BoostedTrees) -> None:
        self._thresholds = [np.unique(trees.threshold[trees.feature == f]) for f in range(trees.n_features)]

    def encode(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the number of thresholds below each value; NaN stays."""
        out = np.zeros(values.shape, np.float32)
        for f, thresholds in enumerate(self._thresholds):
            if len(thresholds):
                column = values[:, f].astype(np.float32)
                out[:, f] = np.where(np.isnan(column), np.nan, np.searchsorted(thresholds, column))
        return out

    def decode(self, trees: BoostedTrees) -> BoostedTrees:
        """Return trees on numbers as trees on values."""
        limits = [self._thresholds[f] for f in trees.feature]
        found = [own[min(int(t), len(own) - 1)] for own, t in zip(limits, trees.threshold, strict=True)]
        return replace(trees, threshold=np.array(found, np.float32))
