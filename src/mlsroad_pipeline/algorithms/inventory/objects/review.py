"""Order in which objects are reviewed, and the precision expected after a number of looks.

The order joins the criteria of active learning: uncertainty sampling (Lewis and Gale 1994), the number of points that
an answer settles, distance from the bulk of the kind, and the diversity of a core set (k-centre greedy, Sener and
Savarese 2018), weighted by the uncertainty.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

SHAPE = ("height", "width", "length", "diameter", "tilt", "clearance", "visible_share", "disagreeing_share", "score")
"""Columns of the inventory that make objects alike, as far as a table has them."""

UNSURE, UNUSUAL = 0.35, 2.5
"""Least entropy (1 for a score of 0.5) and least distance from the bulk of its kind (robust standard deviations) that
are given as a reason."""

FAR = 25.0
"""Distance from the path beyond which objects come last, metres: their points are sparse."""

_ENTROPY_FLOOR = 0.02  # a certain object is looked at last, but is looked at
_LAST = 1e6  # more than any worth
_NEAR = 0.25  # distance below which two objects of a kind are alike, robust standard deviations per column


class ReviewOrder(NamedTuple):
    """Objects in the order of review."""

    rows: NDArray[np.int64]  # Rows of the table
    reasons: list[str]  # Why each is looked at
    # Expected precision of the inventory after this look and those before, from calibrated scores
    precision: NDArray[np.float64]


def order_of_review(table: pd.DataFrame, decided: NDArray[np.floating], number: int) -> ReviewOrder:
    """Return the objects to look at first.

    Each step takes the object with the largest product of entropy of its score, logarithm of its points, distance from
    the bulk of its kind and distance to the nearest object of its kind that is already decided or taken. Objects
    farther than `FAR` from the path come after all others.
    """
    score = np.clip(np.nan_to_num(table["score"].to_numpy(dtype=np.float64), nan=0.5), 0.0, 1.0)
    done = ~np.isnan(decided)
    shape = _standardised(table)
    kind = pd.factorize(table["kind"])[0]
    entropy = _entropy(score)
    unusual = np.sqrt((np.minimum(np.abs(shape), 10.0) ** 2).mean(axis=1)) if shape.shape[1] else np.zeros(len(table))
    size = np.log10(10.0 + np.nan_to_num(table["point_count"].to_numpy(dtype=np.float64)))
    worth = (_ENTROPY_FLOOR + entropy) * size * (1.0 + np.minimum(unusual, 2 * UNUSUAL) / UNUSUAL)
    members = {int(k): np.flatnonzero(kind == k) for k in np.unique(kind)}
    novelty = np.ones(len(table))
    for known in np.flatnonzero(done).tolist():
        own = members[int(kind[known])]
        novelty[own] = np.minimum(novelty[own], _distances(shape[own], shape[known]))
    offset = table["offset"].to_numpy(dtype=np.float64) if "offset" in table else np.zeros(len(table))
    is_far = np.abs(np.nan_to_num(offset)) > FAR
    rows: list[int] = []
    left = ~done
    for _ in range(min(number, int(left.sum()))):
        row = int(np.argmax(np.where(left, worth * novelty - _LAST * is_far, -np.inf)))
        rows.append(row)
        left[row], own = False, members[int(kind[row])]
        novelty[own] = np.minimum(novelty[own], _distances(shape[own], shape[row]))
    order = np.array(rows, dtype=np.int64)
    reasons = [_reason(score[r], float(entropy[r]), float(unusual[r]), float(size[r] - np.median(size))) for r in rows]
    reasons = [
        f"{abs(offset[r]):.0f} m from the path; {reason}" if is_far[r] else reason
        for r, reason in zip(rows, reasons, strict=True)
    ]
    return ReviewOrder(order, reasons, expected_precision(score, decided, order))


def expected_precision(
    score: NDArray[np.float64], decided: NDArray[np.floating], order: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the expected share of right objects after each look; wrong objects are taken out as they are found.

    Examples
    --------
    >>> expected_precision(np.array([0.5, 1.0]), np.array([np.nan, np.nan]), np.array([0, 1])).round(3)
    array([1., 1.])
    >>> expected_precision(np.array([0.5, 0.5]), np.array([np.nan, np.nan]), np.array([0])).round(3)
    array([0.667])
    """
    known = np.where(np.isnan(decided), score, decided)
    right = known.sum()
    listed = len(score) - (decided == 0).sum() - np.cumsum(1.0 - known[order])
    return np.divide(right, listed, out=np.ones(len(order)), where=listed > 1e-9)


def _entropy(score: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the binary entropy, 1 at 0.5."""
    inside = np.clip(score, 1e-9, 1 - 1e-9)
    return -(inside * np.log2(inside) + (1 - inside) * np.log2(1 - inside))


def _standardised(table: pd.DataFrame) -> NDArray[np.float64]:
    """Return the columns of `SHAPE` in robust standard deviations from the median of the kind; 0 where unknown."""
    names = [name for name in SHAPE if name in table]
    values = table[names].astype("float64")
    grouped = values.groupby(table["kind"].to_numpy())
    away = values - grouped.transform("median")
    spread = 1.4826 * away.abs().groupby(table["kind"].to_numpy()).transform("median")
    overall = values.std(ddof=0).fillna(0.0)
    scale = spread.to_numpy(dtype=np.float64)
    scale = np.where(scale > 0, scale, overall.to_numpy(dtype=np.float64))
    return np.nan_to_num(away.to_numpy(dtype=np.float64) / np.where(scale > 0, scale, 1.0))


def _distances(shape: NDArray[np.float64], one: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how unlike each object is to one of its kind, 0 to 1."""
    if not len(one):
        return np.full(len(shape), _NEAR)
    apart = np.sqrt(((shape - one) ** 2).mean(axis=1))
    return apart / (apart + _NEAR)


def _reason(score: float, entropy: float, unusual: float, larger: float) -> str:
    reasons = []
    if entropy >= UNSURE:
        reasons.append(f"uncertain (score {score:.2f})")
    if unusual >= UNUSUAL:
        reasons.append("unlike others of its kind")
    if larger >= 0.5:
        reasons.append("many points")
    return "; ".join(reasons) or "one of a group of alike objects"
