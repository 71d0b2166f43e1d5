"""Calibration of confidences: reliability table, expected calibration error, AUROC and Brier score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least


@dataclass(frozen=True)
class ReliabilityTable:
    """Points, correct points and sum of confidences in equal-width bins of the confidence; tables of scenes add up."""

    counts: NDArray[np.int64]
    hits: NDArray[np.int64]
    confidences: NDArray[np.float64]

    def __add__(self, other: ReliabilityTable) -> ReliabilityTable:
        """Return the table of the points of both tables."""
        return ReliabilityTable(
            self.counts + other.counts, self.hits + other.hits, self.confidences + other.confidences
        )

    @property
    def accuracy(self) -> NDArray[np.float64]:
        """Return the share of correct points of each bin; NaN for an empty bin."""
        return _mean(self.hits, self.counts)

    @property
    def confidence(self) -> NDArray[np.float64]:
        """Return the mean confidence of each bin; NaN for an empty bin."""
        return _mean(self.confidences, self.counts)

    @property
    def calibration_error(self) -> float:
        """Return the expected calibration error; NaN without points.

        The mean over points of the difference between accuracy and mean confidence of their bin (Guo et al. 2017,
        equation 3).
        """
        total = int(self.counts.sum())
        return float(np.abs(self.hits - self.confidences).sum() / total) if total else float("nan")


def _mean(sums: NDArray, counts: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.divide(sums, counts, out=np.full(len(counts), np.nan), where=counts > 0)


def _checked(confidence: ArrayLike, right: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    values, flags = np.asarray(confidence, dtype=np.float64), np.asarray(right, dtype=np.bool_)
    if values.ndim != 1 or values.shape != flags.shape:
        raise DataError(f"confidences and flags must have one shape (n,), got {values.shape} and {flags.shape}")
    if len(values) and not (values.min() >= 0 and values.max() <= 1):
        raise DataError(f"confidences must be in [0, 1], got {values.min():g} to {values.max():g}")
    return values, flags


def reliability_table(confidence: ArrayLike, right: ArrayLike, *, n_bins: int = 15) -> ReliabilityTable:
    """Count points and correct points in equal-width bins of the confidence (Guo et al. 2017 use 15).

    A bin contains its lower end, the last one both ends.

    Examples
    --------
    >>> table = reliability_table([0.9, 0.9, 0.2], [True, False, False], n_bins=2)
    >>> table.counts.tolist(), round(table.calibration_error, 3)
    ([1, 2], 0.333)
    """
    check_at_least(n_bins, 1, "n_bins")
    values, flags = _checked(confidence, right)
    bins = np.minimum((values * n_bins).astype(np.int64), n_bins - 1)
    return ReliabilityTable(
        np.bincount(bins, minlength=n_bins),
        np.bincount(bins[flags], minlength=n_bins),
        np.bincount(bins, weights=values, minlength=n_bins).astype(np.float64),
    )


def auroc(confidence: ArrayLike, right: ArrayLike) -> float:
    """Return the area under the ROC curve of the confidence as a detector of correct points; NaN without both kinds.

    It is the probability that a random correct point has a higher confidence than a random wrong one; ties count half.

    Examples
    --------
    >>> auroc([0.9, 0.6, 0.7, 0.2], [True, True, False, False])
    0.75
    """
    values, flags = _checked(confidence, right)
    n_right = int(flags.sum())
    n_wrong = len(flags) - n_right
    if n_right == 0 or n_wrong == 0:
        return float("nan")
    _, group, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - (counts - 1) / 2  # mean rank of equal values, from 1
    return float((ranks[group[flags]].sum() - n_right * (n_right + 1) / 2) / (n_right * n_wrong))


def brier_score(confidence: ArrayLike, right: ArrayLike) -> float:
    """Return the mean squared difference between confidence and correctness (Brier 1950).

    Examples
    --------
    >>> brier_score([1.0, 0.5], [True, False])
    0.125
    """
    values, flags = _checked(confidence, right)
    return float(np.mean((values - flags) ** 2)) if len(values) else float("nan")
