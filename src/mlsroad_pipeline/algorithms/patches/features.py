"""What classifiers see of a patch: histogram, height and colour, the description of Luo et al. 2016, section III-A.

A model holds a classifier for patches with colour, where the training scenes have it, and one for patches without, so
that a survey without colour is labelled by a classifier that never saw any.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.class_balance import draw_per_class
from mlsroad_pipeline.algorithms.patches.extraction import Patches

GEOMETRY, COLOURED = "geometry", "geometry+rgb"
"""The variants of a classifier."""


def variants_of(patches: Patches) -> tuple[str, ...]:
    """Return the variants that can be trained on patches, the one with most features last.

    Parameters
    ----------
    patches : Patches
        The patches.

    Returns
    -------
    tuple of str
        `GEOMETRY`, and `COLOURED` where they have colour.
    """
    return (GEOMETRY,) if patches.rgb is None else (GEOMETRY, COLOURED)


def patch_features(patches: Patches, variant: str) -> NDArray[np.float32]:
    """Return the features of patches.

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
        If the variant needs colour and the patches have none.
    """
    parts = [patches.fpfh, patches.height[:, None]]
    if variant == COLOURED:
        if patches.rgb is None:
            raise DataError("patches without colour cannot be described with it")
        parts.append(patches.rgb)
    return np.concatenate(parts, axis=1)


def draw_training_patches(patches: Patches, max_per_class: int, *, seed: int) -> Patches:
    """Draw a balanced sample of labelled patches (Luo et al. 2016, section IV-C: 10,000 of each class).

    Parameters
    ----------
    patches : Patches
        Patches; those without a label are left out.
    max_per_class : int
        Most patches of a class; a class with fewer gives all of them.
    seed : int
        Seed of the draw.

    Returns
    -------
    Patches
        The sample, in the order of the patches.

    Raises
    ------
    DataError
        If no patch is labelled.
    """
    rows = draw_per_class(patches.label, max_per_class, seed=seed)
    if len(rows) == 0:
        raise DataError("no labelled patches to train on")
    return patches.take(rows)
