"""What workers do with the scenes of a comparison: apply a stored model of a method to what the stages before gave."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.shape_based.labeller import label_objects
from mlsroad_pipeline.algorithms.core.labels import PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.patches.labelling import PatchClassifier, ScenePatches, label_patch_scene
from mlsroad_pipeline.algorithms.stages import Ground
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model


def label_prepared_patches(
    scene: PointCloud, patches: ScenePatches, model: str, *, classifier: type[PatchClassifier]
) -> PointLabels:
    """Label a scene of a comparison with a stored model of a method that labels patches."""
    return label_patch_scene(scene, patches, open_model(model), classifier)


def detect_described_objects(parts: Mapping[str, NDArray], model: str) -> dict[str, NDArray]:
    """Detect the objects of a scene of a comparison with a stored model."""
    bundle = open_model(model)
    found: dict[str, NDArray] = METHODS[bundle.slug].load("use")(parts, bundle)
    return found


def label_prepared_objects(scene: PointCloud, ground: Ground, patches: ScenePatches, model: str) -> PointLabels:
    """Label the objects of a scene of a comparison with a stored model of shape-based recognition."""
    return label_objects(scene, ground, patches, open_model(model))
