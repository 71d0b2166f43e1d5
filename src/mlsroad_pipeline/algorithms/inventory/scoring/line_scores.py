"""Scores of lines: the length that is found, and the length that is right."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive

STEP = 0.1
"""Spacing of places along a line, metres."""


class LineScores(NamedTuple):
    """Lengths of true and listed lines, metres, and their shares within a distance of each other."""

    # true, listed: length of the true and of the listed lines, metres
    true: float
    listed: float
    found: float  # Share of the true length with a listed line nearby; NaN without true lines
    right: float  # Share of the listed length with a true line nearby; NaN without listed lines


def places_along(lines: Sequence[ArrayLike], *, step: float = STEP, solid: bool = False) -> NDArray[np.float64]:
    """Return evenly spaced places along lines."""
    check_positive(step, "step")
    columns = 3 if solid else 2
    parts = [np.zeros((0, columns))]
    for line in lines:
        vertices = np.asarray(line, dtype=np.float64)[:, :columns]
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vertices[:, :2], axis=0).T))])
        at = np.arange(step / 2, way[-1], step)
        parts.append(np.column_stack([np.interp(at, way, vertices[:, k]) for k in range(columns)]))
    return np.concatenate(parts)


def score_lines(
    listed: NDArray[np.float64],
    true: NDArray[np.float64],
    *,
    within: float,
    uncounted: NDArray[np.float64] | None = None,
    step: float = STEP,
) -> LineScores:
    """Compare listed lines with true ones."""
    check_positive(within, "within")
    shapes = {places.shape[1:] for places in (listed, true, uncounted) if places is not None}
    if len(shapes) > 1:
        raise ParameterError(f"places must have the same number of coordinates, got {sorted(shapes)}")
    allowed = true if uncounted is None else np.concatenate([true, uncounted])
    return LineScores(
        len(true) * step, len(listed) * step, _share(true, listed, within), _share(listed, allowed, within)
    )


def _share(places: NDArray[np.float64], others: NDArray[np.float64], within: float) -> float:
    if len(places) == 0:
        return float("nan")
    if len(others) == 0:
        return 0.0
    return float((cKDTree(others).query(places)[0] <= within).mean())
