"""Labelling of points by a trained detrended forest (Tomic et al. 2019, section 2.1).

A model holds one forest for each combination of colour and intensity in the training scenes. A survey without colour is
labelled by a forest trained without colour. Models are trained in `training`.
"""

import logging
from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.labels import PointLabels, unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground, SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.features.detrending import local_tendency
from mlsroad_pipeline.algorithms.geometry.threads import check_threads
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under, missing_attributes
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, ground_of, inliers


def smooth_probabilities(
    probabilities: NDArray[np.float32], adjacency: csr_array, *, weight: float
) -> NDArray[np.float32]:
    """Smooth class probabilities over first-order neighbours.

    Tomic et al. 2019, section 4, mention this local regularisation without a formula. Here
    P' = (1 - weight) P + weight mean(P of the neighbours).
    """
    if not 0 <= weight <= 1:
        raise ParameterError(f"weight must be in [0, 1], got {weight!r}")
    n = len(probabilities)
    if adjacency.shape != (n, n):
        raise DataError(f"adjacency must have shape ({n}, {n}), got {adjacency.shape}")
    share = np.float32(weight)
    mixed = (1 - share) * probabilities + share * local_tendency(probabilities, adjacency)
    alone = np.diff(adjacency.indptr) == 0
    return np.where(alone[:, None], probabilities, mixed)


def nearest_supervoxels(xyz: ArrayLike, centroids: ArrayLike, *, n_threads: int = 1) -> NDArray[np.int32]:
    """Return the supervoxel with the nearest centroid for each point, the first of equally near ones."""
    check_threads(n_threads)
    seeds = check_xyz(centroids, minimum=1, name="centroids").astype(np.float64)
    points = check_xyz(xyz).astype(np.float64)
    tree = cKDTree(seeds)
    distance, nearest = tree.query(points, k=[1, 2], workers=n_threads)
    out = nearest[:, 0].astype(np.int32)
    for row in np.flatnonzero(distance[:, 0] == distance[:, 1]):  # the tree returns any of equally near centroids
        near = np.sort(tree.query_ball_point(points[row], distance[row, 0] * (1 + 1e-12)))
        out[row] = near[((seeds[near] - points[row]) ** 2).sum(axis=1).argmin()]
    return out


def label_points(
    xyz: ArrayLike,
    centroids: ArrayLike,
    probabilities: ArrayLike,
    *,
    rule: Literal["nearest", "own"] = "nearest",
    supervoxel_labels: ArrayLike | None = None,
    n_threads: int = 1,
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Assign to each point the most probable class of its supervoxel (Tomic et al. 2019, sections 2 and 3.3)."""
    table = np.asarray(probabilities, dtype=np.float32)
    n_supervoxels = len(np.asarray(centroids))
    if table.ndim != 2 or len(table) != n_supervoxels or not table.shape[1] or not np.isfinite(table).all():
        raise DataError(f"probabilities must be finite, of shape ({n_supervoxels}, c), got {table.shape}")
    if rule == "nearest":
        owners = nearest_supervoxels(xyz, centroids, n_threads=n_threads)
    elif rule == "own":
        if supervoxel_labels is None:
            raise DataError("rule 'own' needs supervoxel_labels")
        owners = check_column(supervoxel_labels, len(check_xyz(xyz)), "supervoxel_labels")
        if len(owners) and not 0 <= int(owners.min()) <= int(owners.max()) < n_supervoxels:
            raise DataError(f"supervoxel_labels must be in 0..{n_supervoxels - 1}, got {owners.min()}..{owners.max()}")
    else:
        raise ParameterError(f"rule must be 'nearest' or 'own', got {rule!r}")
    best = table.argmax(axis=1)
    return best.astype(np.int16)[owners], table.max(axis=1)[owners]


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
    arrays = arrays_under(bundle.arrays, f"{variant}.")
    if variant not in bundle.prepared:
        bundle.prepared[variant] = FlatForest.from_arrays(arrays)
    values = np.ascontiguousarray(features["values"][:, columns])
    probabilities = forest_probabilities(bundle.prepared[variant], arrays, values)
    forest = bundle.metadata["parameters"]["forest"]
    if forest["smoothing"] > 0:
        probabilities = smooth_probabilities(probabilities, supervoxels["adjacency"], weight=forest["smoothing"])
    return probabilities


def forest_probabilities(
    forest: FlatForest, arrays: Mapping[str, NDArray], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the probabilities of all classes of the scheme, 0 for classes without training samples."""
    out = np.zeros((len(values), int(arrays["n_classes"])), dtype=np.float32)
    out[:, arrays["trained_classes"]] = forest.predict_proba(values)
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
