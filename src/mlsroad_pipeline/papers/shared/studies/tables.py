"""Tables of all studies: values of the papers, paired intervals, means with spread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.resources import files
from io import StringIO

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats


def paper_table(paper: str, name: str) -> pd.DataFrame:
    """Return a table of values that a paper prints, from the files of its study."""
    file = files("mlsroad_pipeline.papers").joinpath(paper, "study", "paper", f"{name}.csv")
    return pd.read_csv(StringIO(file.read_text(encoding="utf-8")), comment="#")


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
