"""Features as numbers among the thresholds of trained trees, so that trees that are added use no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees


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
