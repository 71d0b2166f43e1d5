"""Orientation features of supervoxels (Tomic et al. 2019, section 2.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ORIENTATION_FEATURES = ("normal_z", "verticality", "direction_z")
"""Columns of `describe_orientation`."""


def describe_orientation(rows: NDArray[np.float32], names: tuple[str, ...]) -> NDArray[np.float32]:
    """Take the orientation features from rows of eigenvalue features.

    Only what does not change when the scene is turned about the vertical axis is kept: where a street runs must not
    decide what stands in it.

    Parameters
    ----------
    rows : ndarray of float32, shape (s, f)
        Eigenvalue features, the columns named by `names`.
    names : tuple of str
        Must hold ``nz``, ``verticality`` and ``direction_z``.

    Returns
    -------
    ndarray of float32, shape (s, 3)
        Columns of `ORIENTATION_FEATURES`: z of the unit normal (1: horizontal surface), 1 minus it (1: wall), z of the
        main direction (1: upright pole, 0: wire); NaN where the points are collinear (the first two), coincide or are
        fewer than three.
    """
    return rows[:, [names.index(name) for name in ("nz", "verticality", "direction_z")]]
