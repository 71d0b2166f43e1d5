"""Foliage above the upper end of an upright line: the crown of a tree lies around it, that of a neighbour aside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.segmentation.stems import Stem

CROWN_FEATURES = ("crown_inner", "crown_outer", "crown_aside", "crown_depth", "beside")
"""Features of the places around the upper end of a stem."""

RADIUS = 3.5
"""Largest distance of a place from the axis, metres."""

_CORE, _INNER = 0.3, 1.0  # distances from the axis, metres
_OVERLAP = 0.5  # length below the upper end that belongs to a crown, metres
_LEAST = 5  # places of a crown whose middle is measured


def crown_features(stems: Sequence[Stem], xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what lies around the upper ends of stems.

    Parameters
    ----------
    stems : sequence of Stem
        The stems.
    xyz : ndarray of float64, shape (n, 3)
        Places of the scene that may be of poles, signs or trees, such as means of voxels, metres.

    Returns
    -------
    ndarray of float64, shape (s, len(CROWN_FEATURES))
        Logarithm of the number of places above the end within 1 m of the axis, and around the end from 1 to 3.5 m;
        distance of the middle of these places from the axis, relative to their mean distance, NaN for fewer than five;
        height of the highest place above the end, metres; logarithm of the number of places from 0.3 to 3.5 m beside
        the upper half of the stem.
    """
    found = np.full((len(stems), len(CROWN_FEATURES)), np.nan)
    if not len(stems):
        return found
    ends = np.array([stem.at(stem.high) for stem in stems])
    near = cKDTree(xyz[:, :2]).query_ball_point(ends, RADIUS + 1.0)
    for k, (stem, rows) in enumerate(zip(stems, near, strict=True)):
        places = xyz[rows]
        away, z = stem.away(places), places[:, 2]
        distance = np.hypot(away[:, 0], away[:, 1])
        within = distance < RADIUS
        above = within & (z > stem.high - _OVERLAP) & ((distance > _CORE) | (z > stem.high))
        inner, outer = above & (distance < _INNER) & (z > stem.high), above & (distance >= _INNER)
        aside = np.nan
        if above.sum() >= _LEAST:
            aside = float(np.hypot(*away[above].mean(axis=0)) / distance[above].mean())
        middle = (stem.low + stem.high) / 2
        beside = within & (distance > _CORE) & (z > middle) & (z <= stem.high - _OVERLAP)
        depth = max(float(z[above].max()) - stem.high, 0.0) if above.any() else 0.0
        found[k] = np.log1p(inner.sum()), np.log1p(outer.sum()), aside, depth, np.log1p(beside.sum())
    return found
