"""Trees from the text of a LightGBM model."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError

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
