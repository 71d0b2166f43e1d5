"""What workers of a comparison do with a stored fusion."""

from __future__ import annotations

from mlsroad_pipeline.algorithms.core.labels import ImagePredictions, PointLabels
from mlsroad_pipeline.algorithms.fusion.labeller import FusedSceneLabels, fuse_scene
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model


def fuse_labelled_scene(features: PointLabels, images: ImagePredictions, model: str) -> FusedSceneLabels:
    """Fuse the labels of a scene."""
    return fuse_scene(features, images, open_model(model))
