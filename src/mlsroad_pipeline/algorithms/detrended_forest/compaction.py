"""Compact form of a detrended forest, for models that are distributed with the package."""

from __future__ import annotations

from dataclasses import replace

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.algorithms.models.compact_forest import compact_forest


def compact_bundle(bundle: ModelBundle) -> ModelBundle:
    """Return a model with the arrays of `compact_forest`, a tenth of the size.

    Parameters
    ----------
    bundle : ModelBundle
        A model of `training.fit`.

    Returns
    -------
    ModelBundle
        The model; labels of a few supervoxels in a thousand differ.
    """
    arrays = {
        f"{variant}.{name}": values
        for variant in bundle.metadata["feature_names"]
        for name, values in compact_forest(arrays_under(bundle.arrays, f"{variant}.")).items()
        if name != "feature_names"  # the metadata hold them
    }
    return replace(bundle, arrays=arrays)
