"""Precision and recall of an inventory from the decisions about some of its objects, with intervals."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FEWEST = 5
"""Fewest decided objects of a stratum."""

_NORMAL = 1.959963984540054  # quantile of the normal distribution for 95 %


class Estimate(NamedTuple):
    """A share with its interval of 95 %."""

    share: float
    low: float
    high: float

    def __str__(self) -> str:
        """Return the share and its interval, a dash without one."""
        if np.isnan(self.share):
            return "–"
        return f"{self.share:.2f} ({self.low:.2f} to {self.high:.2f})"


UNKNOWN = Estimate(np.nan, np.nan, np.nan)


def wilson(share: float, size: float) -> Estimate:
    """Return a share of a sample with the interval of Wilson (1927); a sample without end has no uncertainty.

    Examples
    --------
    >>> print(wilson(0.8, 10))
    0.80 (0.49 to 0.94)
    """
    if not size > 0:
        return UNKNOWN
    square = _NORMAL**2 / size
    middle = (share + square / 2) / (1 + square)
    half = np.sqrt(square * (share * (1 - share) + square / 4)) / (1 + square)
    return Estimate(share, float(max(0.0, middle - half)), float(min(1.0, middle + half)))


class Strata(NamedTuple):
    """Strata of the objects of a kind by score: number of objects, of decided ones, and of right ones among these."""

    size: NDArray[np.int64]
    decided: NDArray[np.int64]
    right: NDArray[np.int64]

    @property
    def shares(self) -> NDArray[np.float64]:
        """Share of right objects among the decided ones of each stratum."""
        share: NDArray[np.float64] = self.right / self.decided
        return share

    @property
    def precision(self) -> Estimate:
        """Precision of all objects: each stratum has the share of its decided ones."""
        if not len(self.size):
            return UNKNOWN
        weight = self.size / self.size.sum()
        share = float(weight @ self.shares)
        # A stratum of right objects alone is not certain: two more answers, one right and one wrong, give its variance.
        careful = (self.right + 1) / (self.decided + 2)
        left = 1 - self.decided / self.size
        variance = float((weight**2 * careful * (1 - careful) / self.decided * left).sum())
        if variance == 0:  # all were looked at
            return Estimate(share, share, share)
        middle = (share * self.decided.sum() + 1) / (self.decided.sum() + 2)
        return wilson(share, middle * (1 - middle) / variance)


def strata_of(score: NDArray[np.float64], decided: NDArray[np.bool_], right: NDArray[np.bool_]) -> Strata:
    """Return strata of ascending score with at least `FEWEST` decided objects each; none without decisions.

    Decisions begin with uncertain objects, so that all decided ones together would not be a sample of the listed ones.
    """
    order = np.argsort(score, kind="stable")
    done = np.cumsum(decided[order])
    if not len(done) or not done[-1]:
        return Strata(*(np.zeros(0, np.int64) for _ in range(3)))
    n_strata = max(1, int(done[-1]) // FEWEST)
    stratum = np.minimum(np.maximum(done - 1, 0) * n_strata // int(done[-1]), n_strata - 1)
    chosen = decided[order]
    counts = (
        np.bincount(stratum[rows], minlength=n_strata)
        for rows in (np.ones(len(order), bool), chosen, chosen & right[order])
    )
    return Strata(*counts)
