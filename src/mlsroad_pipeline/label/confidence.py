"""Distribution of the confidences of a labelled survey, and warnings."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

N_BINS = 100
"""Number of bins of a histogram of confidences from 0 to 1."""

LOW = 0.5
"""Low confidence: below it, the other classes together are more probable than the assigned one."""

LARGE_SHARE = 0.2
"""Share of points of low confidence at which a warning is given. A model of simulated streets has 5 % on another
simulated street, and 30 to 89 % on recordings of three other scanners."""

LEAST_GROUND = 0.05
"""Share of ground points below which a warning is given: 28 simulated streets and recordings have 29 % to 86 %."""

FEW = 1000
"""Smallest number of points of a class for a warning about it."""


def count_confidences(
    label: NDArray[np.integer], confidence: NDArray[np.floating], n_classes: int
) -> NDArray[np.int64]:
    """Return the number of points per class and confidence bin, shape (classes, N_BINS)."""
    bins = np.minimum((confidence * np.float32(N_BINS)).astype(np.int32), N_BINS - 1)
    cells = label.astype(np.int32) * N_BINS + bins
    counts = np.bincount(cells[label >= 0], minlength=n_classes * N_BINS)
    return counts.reshape(n_classes, N_BINS).astype(np.int64)


def confidence_table(counts: NDArray[np.int64], classes: Sequence[str]) -> pd.DataFrame:
    """Return number of points, median confidence and share of low confidence, per class and overall."""
    rows = [(name, row) for name, row in zip(classes, counts, strict=True) if row.any()]
    rows.append(("all", counts.sum(axis=0)))
    n_low = round(LOW * N_BINS)
    table = [
        {
            "class": name,
            "points": int(row.sum()),
            "median_confidence": _median(row),
            f"share_below_{LOW}": float(row[:n_low].sum() / row.sum()) if row.any() else float("nan"),
        }
        for name, row in rows
    ]
    return pd.DataFrame(table).round(3)


def _median(row: NDArray[np.int64]) -> float:
    if not row.any():
        return float("nan")
    return (float(np.searchsorted(np.cumsum(row), row.sum() / 2)) + 0.5) / N_BINS


def confidence_warnings(table: pd.DataFrame) -> list[str]:
    """Return warnings for a large share of low confidence in the survey, and for classes of low confidence."""
    share = f"share_below_{LOW}"
    warnings = []
    whole = table[table["class"] == "all"].iloc[0]
    if whole[share] >= LARGE_SHARE:
        warnings.append(
            f"{whole[share]:.0%} of the points have a confidence below {LOW} (warns from {LARGE_SHARE:.0%}): the "
            "survey differs from the training data, or its classes are hard to separate. Check the labels before use."
        )
    uncertain = table[(table["class"] != "all") & (table["points"] >= FEW) & (table["median_confidence"] < LOW)]
    if len(uncertain):
        medians = zip(uncertain["class"], uncertain["median_confidence"], strict=True)
        named = ", ".join(f"{name} ({median:.2f})" for name, median in medians)
        warnings.append(f"Classes with a median confidence below {LOW}: {named}.")
    return warnings


def ground_warnings(counts: NDArray[np.int64], is_ground: NDArray[np.bool_]) -> list[str]:
    """Return a warning for a survey with hardly any ground; `counts` as of `count_confidences`, flags per class."""
    of_class = counts.sum(axis=1)
    total, ground = int(of_class.sum()), int(of_class[is_ground].sum())
    if total < FEW or not is_ground.any() or ground >= LEAST_GROUND * total:
        return []
    return [
        f"{ground / total:.1%} of the points are ground (warns below {LEAST_GROUND:.0%}): the ground was cut away or "
        "was not found, and heights are wrong without it. Do not trust the labels, even with a high confidence."
    ]
