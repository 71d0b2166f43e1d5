"""What workers of a comparison do with the detrended forest: label a scene that the stages before it have prepared."""

from __future__ import annotations

from mlsroad_pipeline.algorithms.core.labels import PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detrended_forest.labeller import label_scene
from mlsroad_pipeline.algorithms.stages import SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model


def label_prepared_scene(
    scene: PointCloud, supervoxels: SupervoxelPartition, features: SupervoxelTable, model: str
) -> PointLabels:
    """Label a scene of a comparison with a stored model."""
    return label_scene(scene, supervoxels, features, open_model(model))
