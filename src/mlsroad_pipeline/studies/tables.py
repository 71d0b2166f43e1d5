"""What the tables of all studies share: paired intervals, means with their spread, and tables by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats


@dataclass(frozen=True)
class Tables:
    """The tables of a study: a study derives a class whose fields are its tables, named as in the catalog."""

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the tables in their order."""
        return tuple(entry.name for entry in fields(cls))

    def as_tuple(self) -> tuple[Any, ...]:
        """Return the tables in their order."""
        return tuple(getattr(self, name) for name in self.names())


def paired_interval(differences: NDArray[np.floating], confidence: float = 0.95) -> tuple[float, float, float, int]:
    """Return the mean of paired differences and its interval after Student."""
    known = np.asarray(differences, dtype=np.float64)
    known = known[np.isfinite(known)]
    n = len(known)
    mean = float(known.mean()) if n else np.nan
    half = np.nan
    if n > 1:
        half = float(stats.t.ppf(0.5 + confidence / 2, n - 1) * known.std(ddof=1) / np.sqrt(n))
    return mean, mean - half, mean + half, n


def mean_and_spread(rows: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Average columns over streets, with their spread."""
    groups = rows.groupby(list(by), sort=False)[list(columns)]
    spread: Callable[[str], str] = "{}_spread".format
    return groups.mean().join(groups.std().rename(columns=spread)).reset_index()
