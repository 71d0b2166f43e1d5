"""Feature vectors of patches: histogram, height and colour (Luo et al. 2016, section III-A).

A model holds one classifier for patches without colour and one for patches with colour, if the training scenes have it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.machines.class_balance import draw_per_class
from mlsroad_pipeline.papers.shared.patches.table import Patches

GEOMETRY, COLOURED = "geometry", "geometry+rgb"
"""Feature sets without and with colour."""


def variants_of(patches: Patches) -> tuple[str, ...]:
    """Return the feature sets available for patches, the largest last.

    Parameters
    ----------
    patches : Patches
        The patches.

    Returns
    -------
    tuple of str
        `GEOMETRY`, followed by `COLOURED` if the patches have colour.
    """
    return (GEOMETRY,) if patches.rgb is None else (GEOMETRY, COLOURED)


def patch_features(patches: Patches, variant: str) -> NDArray[np.float32]:
    """Return the feature vectors of patches.

    Parameters
    ----------
    patches : Patches
        The patches.
    variant : str
        `GEOMETRY` or `COLOURED`.

    Returns
    -------
    ndarray of float32, shape (n, d + 1) or (n, d + 4)
        Histogram, height in metres and, with colour, red, green and blue in [0, 1].

    Raises
    ------
    DataError
        If `variant` is `COLOURED` and the patches have no colour.
    """
    parts = [patches.fpfh, patches.height[:, None]]
    if variant == COLOURED:
        if patches.rgb is None:
            raise DataError("patches have no colour: features with colour cannot be computed")
        parts.append(patches.rgb)
    return np.concatenate(parts, axis=1)


def draw_training_patches(patches: Patches, max_per_class: int, *, seed: int) -> Patches:
    """Draw a random sample with a maximum size per class (Luo et al. 2016, section IV-C: 10,000).

    Parameters
    ----------
    patches : Patches
        Patches; unlabelled ones are excluded.
    max_per_class : int
        Maximum patches per class; smaller classes are taken whole.
    seed : int
        Seed of the sample.

    Returns
    -------
    Patches
        The sample, in the order of `patches`.

    Raises
    ------
    DataError
        If no patch is labelled.
    """
    rows = draw_per_class(patches.label, max_per_class, seed=seed)
    if len(rows) == 0:
        raise DataError("no labelled patches to train on")
    return patches.take(rows)
