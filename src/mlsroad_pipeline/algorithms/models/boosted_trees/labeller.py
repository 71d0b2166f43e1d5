"""Labels of points by trained boosted trees. No LightGBM is needed."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.labels import PointLabels, unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground
from mlsroad_pipeline.algorithms.features.voxel_scales import (
    VoxelFeatures,
    compute_voxel_features,
    known_intensity,
    smooth_by_cells,
)
from mlsroad_pipeline.algorithms.features.voxel_table import voxel_feature_names
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.models.machines.combinations import decide, largest_of_rows
from mlsroad_pipeline.algorithms.stages import ground_of, inlier_rows, inliers


def describe_scene(
    scene: PointCloud,
    ground: Ground,
    *,
    voxel_size: float = 0.2,
    wanted: NDArray[np.bool_] | None = None,
    around: int | None = None,
    n_threads: int = 1,
) -> VoxelFeatures:
    """Compute the features of the voxels of a scene."""
    keep = inlier_rows(scene)
    xyz, height, intensity = scene.xyz[keep], ground["height"][keep], scene.get("intensity")
    if np.isnan(height).all():
        height = (xyz[:, 2] - xyz[:, 2].min()).astype(np.float32)
    if intensity is not None:
        intensity = known_intensity(intensity[keep])
    return compute_voxel_features(
        xyz,
        height=height,
        intensity=intensity,
        voxel_size=voxel_size,
        wanted=None if wanted is None else wanted[keep],
        around=around,
        n_threads=n_threads,
    )


def voxel_probabilities(features: VoxelFeatures, bundle: ModelBundle, *, n_threads: int = 1) -> NDArray[np.float64]:
    """Return the class probabilities of voxels."""
    if bundle.metadata["feature_names"] != voxel_feature_names():
        raise DataError(f"model {bundle.slug!r} has other features than this version: train it again")
    if SLUG not in bundle.prepared:
        bundle.prepared[SLUG] = BoostedTrees.from_arrays(bundle.arrays)
    trees: BoostedTrees = bundle.prepared[SLUG]
    parameters = parameters_of(bundle)
    scores = trees.scores(features.values, n_threads=n_threads)
    probabilities = softmax(scores / bundle.arrays["temperature"] + bundle.arrays["offsets"])
    if features.rows is not None:
        described, probabilities = probabilities, np.zeros((len(features.cells), probabilities.shape[1]))
        probabilities[features.rows] = described
    if parameters.smoothing > 0:
        around = smooth_by_cells(features, probabilities, level=parameters.smoothing_level, n_threads=n_threads)
        probabilities += parameters.smoothing * (around - probabilities)
    return probabilities


def softmax(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the probabilities of scores."""
    powers = np.exp(scores - largest_of_rows(scores))
    return powers / powers.sum(axis=1, keepdims=True)


def parameters_of(bundle: ModelBundle) -> BoostedTreesParameters:
    """Return the parameters that a model was trained with."""
    return BoostedTreesParameters(**bundle.metadata["parameters"][SLUG])


def label_scene(scene: PointCloud, ground: Ground, bundle: ModelBundle) -> PointLabels:
    """Label the points of a scene."""
    soft = _label_softly(scene, ground, bundle)
    return {"label": soft.labels, "confidence": soft.confidence}


def _label_softly(scene: PointCloud, ground: Ground, bundle: ModelBundle) -> SoftLabels:
    label, confidence = unlabelled(len(scene))
    if not inliers(scene).any():
        return SoftLabels(label, confidence)
    keep, parameters = inlier_rows(scene), parameters_of(bundle)
    around = parameters.smoothing_level if parameters.smoothing > 0 else None
    near = scene.get("near")  # the context serves the features alone
    features = describe_scene(scene, ground, voxel_size=parameters.voxel_size, wanted=near, around=around)
    owner = np.full(len(scene), -1, dtype=np.int32)
    owner[keep] = features.owner
    if near is not None:
        keep = inliers(scene) & near
        owner[~keep] = -1
    probabilities = voxel_probabilities(features, bundle)
    best, probability = decide(probabilities, bundle.arrays.get("groups"))
    label[keep], confidence[keep] = best[owner[keep]], probability[owner[keep]]
    return SoftLabels(label, confidence, probabilities.astype(np.float32), owner)


def label_cloud_softly(cloud: PointCloud, bundle: ModelBundle) -> SoftLabels:
    """Label the points of a cloud, and return the class probabilities of its voxels."""
    if len(cloud) == 0 or not inliers(cloud).any():
        return SoftLabels(*unlabelled(len(cloud)))
    return _label_softly(cloud, ground_of(cloud, GroundParameters(**bundle.metadata["parameters"]["ground"])), bundle)
