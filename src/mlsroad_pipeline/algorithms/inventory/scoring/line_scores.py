"""Scores of lines: the length that is found, and the length that is right."""

from __future__ import annotations

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
    """Lengths of true and listed lines, metres, and their shares within a distance of each other.

    Parameters
    ----------
    true, listed : float
        Length of the true and of the listed lines, metres.
    found : float
        Share of the true length with a listed line nearby; NaN without true lines.
    right : float
        Share of the listed length with a true line nearby; NaN without listed lines.
    """

    true: float
    listed: float
    found: float
    right: float


def places_along(lines: Sequence[ArrayLike], *, step: float = STEP, solid: bool = False) -> NDArray[np.float64]:
    """Return evenly spaced places along lines.

    Parameters
    ----------
    lines : sequence of array-like of shape (k, 2) or (k, 3)
        Vertices in metres.
    step : float, default 0.1
        Spacing in plan, metres.
    solid : bool, default False
        Whether places have a height.

    Returns
    -------
    ndarray of float64, shape (n, 2), or (n, 3) with `solid`
        Places in the middle of pieces of `step` metres.

    Raises
    ------
    ParameterError
        If `step` is not positive.
    """
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
    """Compare listed lines with true ones.

    Parameters
    ----------
    listed, true : ndarray of float64, shape (n, 2) or (n, 3)
        Places every `step` metres along the lines, see `places_along`.
    within : float
        Largest distance, in plan for places of two coordinates, metres.
    uncounted : ndarray of float64, shape (m, 2) or (m, 3), optional
        Places of true lines that need not be found, such as hidden ones; a listed line nearby is right.
    step : float, default 0.1
        Spacing of the places, metres.

    Returns
    -------
    LineScores
        Lengths and shares.

    Raises
    ------
    ParameterError
        If `within` is not positive, or the places have different numbers of coordinates.
    """
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
