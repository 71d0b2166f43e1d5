"""What workers of a comparison do with a stored fusion."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.fusion.labeller import fuse_scene
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model


def fuse_labelled_scene(
    features: Mapping[str, NDArray], images: Mapping[str, NDArray], model: str
) -> dict[str, NDArray]:
    """Fuse the labels of a scene."""
    return fuse_scene(features, images, open_model(model))
