"""Compact arrays of a forest, for models that are distributed with the package.

A node takes four to six bytes in place of some forty: children follow from the breadth-first order, thresholds have 16
bits, and leaves refer to a table of their distinct class probabilities, in steps of 1/255.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_arrays

LEVELS = 255
"""Steps of a class probability."""

_NODES = ("roots", "feature", "threshold", "missing_left", "child", "leaf_values", "n_features")
_COMPACT = ("tree_sizes", "columns", "thresholds", "missing", "leaves", "leaf_table", "n_features")


def is_compact(arrays: Mapping[str, NDArray]) -> bool:
    """Return whether arrays are those of `compact_forest`.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Arrays of a forest.

    Returns
    -------
    bool
        Whether they are compact.
    """
    return "leaf_table" in arrays


def compact_forest(arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Return the compact arrays of a forest.

    Thresholds are rounded to float16 (a relative error of at most 0.05 %), probabilities to multiples of 1/255.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Arrays of `FlatForest.to_arrays`; further arrays are returned unchanged.

    Returns
    -------
    dict of str to ndarray
        Arrays for `expanded_forest`.

    Raises
    ------
    DataError
        If an array is missing, or a threshold exceeds the range of float16.
    """
    check_arrays(arrays, _NODES, "a forest")
    feature, threshold = np.asarray(arrays["feature"]), np.asarray(arrays["threshold"])
    leaf = feature < 0
    with np.errstate(over="ignore"):
        thresholds = threshold[~leaf].astype(np.float16)
    outside = np.isinf(thresholds) & np.isfinite(threshold[~leaf])  # an infinite threshold separates NaN from the rest
    if outside.any():
        raise DataError(f"a threshold of {threshold[~leaf][outside][0]:g} exceeds the range of float16")
    steps = np.rint(np.asarray(arrays["leaf_values"]) * LEVELS).astype(np.uint8)
    table, rows = np.unique(steps, axis=0, return_inverse=True)
    n_columns = int(arrays["n_features"]) + 1
    return {
        **{name: np.asarray(values) for name, values in arrays.items() if name not in _NODES},
        "tree_sizes": np.diff(arrays["roots"]).astype(np.int32),
        "columns": (feature + 1).astype(np.min_scalar_type(n_columns)),
        "thresholds": thresholds,
        "missing": np.packbits(arrays["missing_left"]),
        "leaves": rows[arrays["child"][leaf]].astype(np.min_scalar_type(len(table))),
        "leaf_table": table,
        "n_features": np.asarray(arrays["n_features"]),
    }


def expanded_forest(arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Return the arrays of `FlatForest` from compact ones.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Arrays of `compact_forest`; further arrays are returned unchanged.

    Returns
    -------
    dict of str to ndarray
        Arrays for `FlatForest.from_arrays`; the rows of `leaf_values` are distinct, and leaves share them.

    Raises
    ------
    DataError
        If an array is missing, or their sizes do not fit.
    """
    check_arrays(arrays, _COMPACT, "a compact forest")
    columns = np.asarray(arrays["columns"])
    roots = np.concatenate([[0], np.cumsum(arrays["tree_sizes"], dtype=np.int64)])
    inner = columns > 0
    n_inner = int(np.count_nonzero(inner))
    found = (roots[-1], len(arrays["thresholds"]), len(arrays["leaves"]), len(arrays["missing"]))
    if found != (len(columns), n_inner, len(columns) - n_inner, -(-len(columns) // 8)) or np.diff(roots).min() < 1:
        raise DataError(f"the arrays of a compact forest of {len(columns)} nodes do not fit: the model is damaged")
    threshold = np.zeros(len(columns), np.float32)
    threshold[inner] = arrays["thresholds"]
    child = np.empty(len(columns), np.int32)
    before: NDArray[np.int64] = np.cumsum(inner) - inner  # inner nodes before a node, of all trees
    child[inner] = (1 + 2 * (before - np.repeat(before[roots[:-1]], np.diff(roots))))[inner]
    child[~inner] = arrays["leaves"]
    table = np.asarray(arrays["leaf_table"]).astype(np.float32)
    return {
        **{name: np.asarray(values) for name, values in arrays.items() if name not in _COMPACT},
        "roots": roots,
        "feature": columns.astype(np.int16) - np.int16(1),
        "threshold": threshold,
        "missing_left": np.unpackbits(arrays["missing"], count=len(columns)).astype(bool),
        "child": child,
        "leaf_values": table / np.maximum(table.sum(axis=1, keepdims=True), 1.0),
        "n_features": np.asarray(arrays["n_features"]),
    }
