"""Stages that all methods share: ground, heights, supervoxels and supervoxel features.

Each stage is a function of a scene and of the results of earlier stages. Its result is a mapping of arrays, whose rows
are aligned with the points of the scene or with its supervoxels. The pipelines store the results; a registered model
calls the same functions in memory.

Outliers (column `outlier`) are excluded: they are not ground, their height is NaN and their supervoxel is -1.
"""

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.core.stage_results import Ground, SupervoxelPartition, SupervoxelTable
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.ground.upward_growing import classify_ground
from mlsroad_pipeline.algorithms.supervoxels.vccs import Supervoxels, segment_supervoxels


def inliers(scene: PointCloud) -> NDArray[np.bool_]:
    """Return which points of a scene are not outliers, which its column `outlier` marks."""
    outlier = scene.get("outlier")
    return np.ones(len(scene), dtype=np.bool_) if outlier is None else ~outlier.astype(np.bool_)


def inlier_rows(scene: PointCloud) -> NDArray[np.bool_] | slice:
    """Return the mask of `inliers`, or a slice of all points if there is no outlier: it selects views, not copies."""
    keep = inliers(scene)
    return slice(None) if keep.all() else keep


def find_ground(scene: PointCloud, parameters: GroundParameters) -> Ground:
    """Classify the ground points of a scene and measure the height of every point above them.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    parameters : GroundParameters
        Parameters of the filter.

    Returns
    -------
    Ground
        Ground points and heights.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    keep = inlier_rows(scene)
    options = asdict(parameters)
    cell = options.pop("surface_cell")
    xyz = scene.xyz[keep]
    ground = np.zeros(len(scene), dtype=np.bool_)
    height = np.full(len(scene), np.nan, dtype=np.float32)
    ground[keep] = classify_ground(xyz, **options)
    height[keep] = height_above_ground(xyz, ground[keep], cell_size=cell)
    return {"ground": ground, "height": height}


def ground_of(scene: PointCloud, parameters: GroundParameters) -> Ground:
    """Return the ground from the columns `ground` and `height` of a scene, or compute it where they are missing."""
    if "ground" in scene and "height" in scene:
        return {"ground": scene["ground"], "height": scene["height"]}
    return find_ground(scene, parameters)


def build_supervoxels(scene: PointCloud, parameters: SupervoxelParameters) -> SupervoxelPartition:
    """Partition a scene into supervoxels.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    parameters : SupervoxelParameters
        Parameters of VCCS.

    Returns
    -------
    SupervoxelPartition
        Supervoxel of each point, and their adjacency.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite.
    """
    return _partition(scene, parameters)[0]


def _partition(scene: PointCloud, parameters: SupervoxelParameters) -> tuple[SupervoxelPartition, Supervoxels]:
    """Return the supervoxels of a scene, and those of its inliers with their voxels."""
    keep = inlier_rows(scene)
    colours = scene.get("rgb")
    use_colour = colours is not None and parameters.colour_weight > 0
    supervoxels = segment_supervoxels(
        scene.xyz[keep], rgb=colours[keep] if use_colour and colours is not None else None, **asdict(parameters)
    )
    labels = np.full(len(scene), -1, dtype=np.int32)
    labels[keep] = supervoxels.labels
    return {"labels": labels, "adjacency": supervoxels.adjacency}, supervoxels


def describe_supervoxels(
    scene: PointCloud, ground: Ground, supervoxels: SupervoxelPartition, parameters: FeatureParameters
) -> SupervoxelTable:
    """Compute the features of the supervoxels of a scene.

    Parameters
    ----------
    scene : PointCloud
        The scene.
    ground : Ground
        Its ground.
    supervoxels : SupervoxelPartition
        Its supervoxels.
    parameters : FeatureParameters
        Selection and radii of the features.

    Returns
    -------
    SupervoxelTable
        The features.

    Raises
    ------
    DataError
        If the ground or the supervoxels belong to another scene.
    """
    return _described(scene, ground, supervoxels, parameters, None)


def supervoxels_with_features(
    scene: PointCloud, ground: Ground, sizes: SupervoxelParameters, selection: FeatureParameters
) -> tuple[SupervoxelPartition, SupervoxelTable]:
    """Run `build_supervoxels` and `describe_supervoxels`, which share the voxels if they have the same size."""
    supervoxels, segmented = _partition(scene, sizes)
    voxels = segmented.grid.centroids if selection.ball_voxel_size == segmented.grid.voxel_size else None
    return supervoxels, _described(scene, ground, supervoxels, selection, voxels)


def _described(
    scene: PointCloud,
    ground: Ground,
    supervoxels: SupervoxelPartition,
    parameters: FeatureParameters,
    voxels: NDArray[np.float64] | None,
) -> SupervoxelTable:
    """Return the features of supervoxels, given the means of the points in voxels of the balls if they are known."""
    keep = inlier_rows(scene)
    colours, intensity = scene.get("rgb"), scene.get("intensity")
    features = compute_supervoxel_features(
        scene.xyz[keep],
        supervoxels["labels"][keep],
        supervoxels["adjacency"],
        height_above_ground=ground["height"][keep],
        rgb=None if colours is None else colours[keep],
        intensity=None if intensity is None else intensity[keep],
        **asdict(parameters),
        ball_voxels=voxels,
    )
    return {
        "values": features.values,
        "names": np.array(features.names),
        "centroids": features.centroids,
        "counts": features.counts,
    }
