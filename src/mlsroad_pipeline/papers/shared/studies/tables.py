"""Tables of all studies: base class, paired intervals, means with spread."""

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
    """Base class of the tables of a study; the fields of a derived class are its tables, named as in the catalog."""

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the tables in their order."""
        return tuple(entry.name for entry in fields(cls))

    def as_tuple(self) -> tuple[Any, ...]:
        """Return the tables in their order."""
        return tuple(getattr(self, name) for name in self.names())


def paired_interval(differences: NDArray[np.floating], confidence: float = 0.95) -> tuple[float, float, float, int]:
    """Return mean, lower and upper bound (Student's t) and number of finite paired differences."""
    known = np.asarray(differences, dtype=np.float64)
    known = known[np.isfinite(known)]
    n = len(known)
    mean = float(known.mean()) if n else np.nan
    half = np.nan
    if n > 1:
        half = float(stats.t.ppf(0.5 + confidence / 2, n - 1) * known.std(ddof=1) / np.sqrt(n))
    return mean, mean - half, mean + half, n


def mean_and_spread(rows: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Return mean and standard deviation of columns per group."""
    groups = rows.groupby(list(by), sort=False)[list(columns)]
    spread: Callable[[str], str] = "{}_spread".format
    return groups.mean().join(groups.std().rename(columns=spread)).reset_index()
