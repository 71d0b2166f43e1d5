"""How sure a model is of a survey's labels: counted scene by scene, judged for the whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

N_BINS = 100
"""Bins of a histogram of confidences from 0 to 1."""

LOW = 0.5
"""Below this confidence other classes together are more probable than the one that a point was given."""

LARGE_SHARE = 0.2
"""Share of points of low confidence from which on a reader is warned: a model of simulated streets has 5 % of them on
another simulated street, and 30 to 89 % on real recordings of three other scanners."""

FEW = 1000
"""Points of a class below which its own share says nothing."""


def count_confidences(
    label: NDArray[np.integer], confidence: NDArray[np.floating], n_classes: int
) -> NDArray[np.int64]:
    """Count the confidences of each class."""
    bins = np.minimum((confidence * np.float32(N_BINS)).astype(np.int32), N_BINS - 1)
    cells = label.astype(np.int32) * N_BINS + bins
    counts = np.bincount(cells[label >= 0], minlength=n_classes * N_BINS)
    return counts.reshape(n_classes, N_BINS).astype(np.int64)


def confidence_table(counts: NDArray[np.int64], classes: Sequence[str]) -> pd.DataFrame:
    """Tell the median confidence and the share of points of low confidence, per class and overall."""
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
    """Warn of a survey, or of classes, that the model is not sure of."""
    share = f"share_below_{LOW}"
    found = []
    whole = table[table["class"] == "all"].iloc[0]
    if whole[share] >= LARGE_SHARE:
        found.append(
            f"{whole[share]:.0%} of the points have a confidence below {LOW} (from {LARGE_SHARE:.0%} on this is told): "
            "the survey is unlike what the model was trained on, or its classes are hard to tell apart here. "
            "Look at the labels before using them."
        )
    unsure = table[(table["class"] != "all") & (table["points"] >= FEW) & (table["median_confidence"] < LOW)]
    if len(unsure):
        named = ", ".join(
            f"{name} ({median:.2f})" for name, median in zip(unsure["class"], unsure["median_confidence"], strict=True)
        )
        found.append(f"Classes with a median confidence below {LOW}: {named}.")
    return found
