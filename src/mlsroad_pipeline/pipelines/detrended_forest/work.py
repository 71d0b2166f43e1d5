"""What workers of a comparison do with the detrended forest: label a scene that the stages before it have prepared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detrended_forest.labeller import label_scene
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model


def label_prepared_scene(
    scene: PointCloud, supervoxels: Mapping[str, Any], features: Mapping[str, NDArray], model: str
) -> dict[str, NDArray]:
    """Label a scene of a comparison with a stored model."""
    return label_scene(scene, supervoxels, features, open_model(model))
