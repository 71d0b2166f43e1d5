"""Labelling of points by a trained detrended forest (Tomic et al. 2019, section 2.1).

A model holds one forest for each combination of colour and intensity in the training scenes. A survey without colour is
labelled by a forest trained without colour. Models are trained in `training`.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.labels import PointLabels, unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground, SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under, missing_attributes
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, ground_of, inliers
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labelling import label_points, smooth_probabilities

SLUG = "detrended_forest"

logger = logging.getLogger(__name__)


def label_scene(
    scene: PointCloud, supervoxels: SupervoxelPartition, features: SupervoxelTable, bundle: ModelBundle
) -> PointLabels:
    """Label the points of a prepared scene."""
    probabilities = supervoxel_probabilities(scene, supervoxels, features, bundle)
    keep = inliers(scene)
    label, confidence = unlabelled(len(scene))
    label[keep], confidence[keep] = label_points(
        scene.xyz[keep],
        features["centroids"],
        probabilities,
        supervoxel_labels=supervoxels["labels"][keep],
        rule=bundle.metadata["parameters"]["forest"]["rule"],
    )
    return {"label": label, "confidence": confidence}


def supervoxel_probabilities(
    scene: PointCloud, supervoxels: SupervoxelPartition, features: SupervoxelTable, bundle: ModelBundle
) -> NDArray[np.float32]:
    """Return the class probabilities of the supervoxels of a prepared scene."""
    have = [name for name in bundle.metadata["attributes"] if name in scene]
    variant = "+".join(("geometry", *have))
    names = [str(name) for name in features["names"]]
    missing = [name for name in bundle.metadata["feature_names"][variant] if name not in names]
    if missing:
        raise DataError(f"{scene.source}: the model needs the features {', '.join(missing)}")
    columns = [names.index(name) for name in bundle.metadata["feature_names"][variant]]
    probabilities = _predict(bundle, variant, np.ascontiguousarray(features["values"][:, columns]))
    forest = bundle.metadata["parameters"]["forest"]
    if forest["smoothing"] > 0:
        probabilities = smooth_probabilities(probabilities, supervoxels["adjacency"], weight=forest["smoothing"])
    return probabilities


def _predict(bundle: ModelBundle, variant: str, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the probabilities of all classes of the scheme, 0 for classes without training samples."""
    arrays = arrays_under(bundle.arrays, f"{variant}.")
    if variant not in bundle.prepared:
        bundle.prepared[variant] = FlatForest.from_arrays(arrays)
    out = np.zeros((len(values), int(arrays["n_classes"])), dtype=np.float32)
    out[:, arrays["trained_classes"]] = bundle.prepared[variant].predict_proba(values)
    return out


def prepare(scene: PointCloud, bundle: ModelBundle) -> tuple[Ground, SupervoxelPartition, SupervoxelTable]:
    """Run the stages before the forest with the parameters of the model."""
    stages = StageParameters.from_stored(bundle.metadata["parameters"])
    ground = ground_of(scene, stages.ground)
    supervoxels = build_supervoxels(scene, stages.supervoxels)
    return ground, supervoxels, describe_supervoxels(scene, ground, supervoxels, stages.features)


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Label the points of a cloud: all stages and the forest."""
    if len(cloud) == 0:
        return unlabelled(0)
    absent = missing_attributes(bundle, list(cloud.columns))
    if absent:
        level = logging.INFO if "core" in cloud else logging.WARNING  # scenes of a survey: the caller warns once
        logger.log(level, "%s has no %s: labelled by the forest trained without", cloud.source, " and no ".join(absent))
    _, supervoxels, features = prepare(cloud, bundle)
    labels = label_scene(cloud, supervoxels, features, bundle)
    return labels["label"], labels["confidence"]
