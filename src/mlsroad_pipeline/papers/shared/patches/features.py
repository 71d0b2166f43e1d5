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
    """Return the feature sets available for patches, the largest last."""
    return (GEOMETRY,) if patches.rgb is None else (GEOMETRY, COLOURED)


def patch_features(patches: Patches, variant: str) -> NDArray[np.float32]:
    """Return the feature vectors of patches."""
    parts = [patches.fpfh, patches.height[:, None]]
    if variant == COLOURED:
        if patches.rgb is None:
            raise DataError("patches have no colour: features with colour cannot be computed")
        parts.append(patches.rgb)
    return np.concatenate(parts, axis=1)


def draw_training_patches(patches: Patches, max_per_class: int, *, seed: int) -> Patches:
    """Draw a random sample with a maximum size per class (Luo et al. 2016, section IV-C: 10,000)."""
    rows = draw_per_class(patches.label, max_per_class, seed=seed)
    if len(rows) == 0:
        raise DataError("no labelled patches to train on")
    return patches.take(rows)
