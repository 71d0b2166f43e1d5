"""The stateless kernels that `test_common` puts to the test, each with what its result keeps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.features.accumulation_images import compute_images
from mlsroad_pipeline.algorithms.features.eigen import compute_eigen_features
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.algorithms.features.spin_image import compute_spin_images
from mlsroad_pipeline.algorithms.features.supervoxel_features import compute_supervoxel_features
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.ground.surface import height_above_ground
from mlsroad_pipeline.algorithms.ground.upward_growing import classify_ground
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster, cluster_by_spacing
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters, segment
from mlsroad_pipeline.algorithms.segmentation.two_step import segment_two_step
from mlsroad_pipeline.algorithms.segmentation.yang_dong import segment_yang_dong
from mlsroad_pipeline.algorithms.stages import build_supervoxels, describe_supervoxels, find_ground
from mlsroad_pipeline.algorithms.supervoxels.vccs import segment_supervoxels
from mlsroad_pipeline.papers.tomic2019.image_labels.visibility import DepthBuffer, HiddenPointRemoval, visible_points

DIRECTED = ("nx", "ny", "direction_x", "direction_y")
"""Features that turn with the points."""

UTM = np.array([500_000.0, 5_800_000.0, 300.0])


@dataclass(frozen=True)
class Kernel:
    """A function of coordinates, and what its result keeps.

    Attributes
    ----------
    run : callable
        Coordinates to arrays.
    threads : bool
        Whether it takes `n_threads`.
    partition : bool
        Whether its first array numbers groups of points, so that only the groups count.
    shift : float
        Share of the points whose result may change when all are moved to UTM coordinates: the lattice of its voxels
        stays where it is.
    turn : float or None
        The same for a quarter turn about the z axis; None where groups are numbered in another order then.
    permute : float
        The same for another order of the points.
    minimum : int
        The fewest points that it takes.
    tolerance : float
        What a number may change by when points are moved or turned, beside two thousandths: neighbourhoods made of
        voxels change by the points at a border.
    """

    run: Callable[..., tuple[Any, ...]]
    threads: bool = False
    partition: bool = False
    shift: float = 0.0
    turn: float | None = 0.0
    permute: float = 0.0
    minimum: int = 0
    tolerance: float = 0.0


def _ground(xyz, **options):
    return (classify_ground(xyz, **options),)


def heights_above_ground(xyz, **options):
    return (height_above_ground(xyz, xyz[:, 2] - xyz[:, 2].min(initial=np.inf) < 0.05, **options),)


def _supervoxels(xyz, **options):
    found = segment_supervoxels(xyz, voxel_size=0.2, seed_resolution=0.6, **options)
    return found.labels, found.centroids, found.adjacency


def _eigen(xyz, **options):
    found = compute_eigen_features(xyz, radius=0.5, **options)
    return tuple(found[name] for name in sorted(found) if name not in DIRECTED)


def _nearest_eigen(xyz, **options):
    found = compute_eigen_features(xyz, k=12, **options)
    return tuple(found[name] for name in sorted(found) if name not in DIRECTED)


def _outward(xyz):
    """Return normals that point away from the middle, and so turn with the points."""
    known = np.nan_to_num(xyz, posinf=0.0)
    away = known - (known.mean(axis=0) if len(xyz) else 0.0)
    length = np.linalg.norm(away, axis=1, keepdims=True)
    return np.divide(away, length, out=np.zeros_like(away, dtype=np.float64), where=length > 0)


def _fpfh(xyz, **options):
    return (compute_fpfh(xyz, _outward(xyz), radius=0.4, **options),)


def _spin(xyz, **options):
    return (compute_spin_images(xyz, _outward(xyz), radius=0.4, **options),)


def _two_step(xyz):
    """Scan lines of two scanners; the time follows from the place, so that it moves with the points."""
    known = np.nan_to_num(xyz, posinf=0.0)
    low = known.min(axis=0) if len(xyz) else np.zeros(3)
    across = np.linalg.norm(known - low, axis=1)
    return (segment_two_step(xyz, gps_time=across, scanner=np.zeros(len(xyz), np.uint8)),)


def _images(xyz, **options):
    return tuple(images.reshape(1, -1) for images in compute_images([xyz], **options))


def supervoxel_features(xyz):
    """Features of supervoxels that are cells of a metre; cells that touch are neighbours."""
    low = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    cells, labels = np.unique(np.floor(xyz - low + 0.2503).astype(np.int64), axis=0, return_inverse=True)
    steps = np.abs(cells[:, None] - cells[None]).max(axis=2)
    adjacency = csr_array((steps == 1).astype(np.float64))
    labels, height = labels.ravel().astype(np.int32), (xyz[:, 2] - low[2]).astype(np.float32)
    return (compute_supervoxel_features(xyz, labels, adjacency, height_above_ground=height).values,)


def _camera(xyz):
    """A camera 6 m above the middle of the points that looks down."""
    known = np.nan_to_num(xyz, posinf=0.0).astype(np.float64)
    middle = (known.min(axis=0) + known.max(axis=0)) / 2 if known.size and known.shape[1] == 3 else np.zeros(3)
    down = np.diag([1.0, -1.0, -1.0])
    return Camera([[300, 0, 320], [0, 300, 320], [0, 0, 1]], None, down, -down @ (middle + [0, 0, 6]), 641, 641)


def _pixels(xyz):
    return project_points(xyz, _camera(xyz))[:2]


def _seen(method, xyz):
    return (visible_points(xyz, _camera(xyz), method=method),)


def model_stages(xyz):
    """All stages that a model needs, from raw coordinates on."""
    scene = PointCloud(xyz)
    ground = find_ground(scene, GroundParameters())
    supervoxels = build_supervoxels(scene, SupervoxelParameters())
    features = describe_supervoxels(scene, ground, supervoxels, FeatureParameters())
    return supervoxels["labels"], ground["ground"], features["values"]


KERNELS = {
    "classify_ground": Kernel(_ground, threads=True, shift=0.02, turn=0.05),
    "height_above_ground": Kernel(heights_above_ground, shift=0.02, turn=0.02),
    "segment_supervoxels": Kernel(
        _supervoxels, threads=True, partition=True, shift=0.2, turn=0.6, permute=0.05, minimum=1
    ),
    "compute_eigen_features": Kernel(_eigen, threads=True),
    "compute_eigen_features of k": Kernel(_nearest_eigen, threads=True),
    "compute_fpfh": Kernel(_fpfh, threads=True),
    "compute_spin_images": Kernel(_spin, threads=True),
    "compute_images": Kernel(_images, threads=True, turn=None, minimum=1),
    "cluster": Kernel(partial(lambda xyz: (cluster(xyz, tolerance=0.3),)), partition=True),
    # By the spacing of this road all of it would be one cluster, with many cuts that are as good as each other.
    "segment": Kernel(
        lambda xyz: (segment(xyz, parameters=NormalizedCutParameters(spacing_factor=0)),),
        partition=True,
        shift=0.05,
        turn=0.05,
    ),
    "cluster_by_spacing": Kernel(
        lambda xyz: (cluster_by_spacing(xyz, tolerance=0.1, spacing_factor=1.5, max_tolerance=0.5),),
        partition=True,
        shift=0.05,
        turn=0.05,
    ),
    "segment_yang_dong": Kernel(lambda xyz: (segment_yang_dong(xyz),), partition=True, shift=0.1, turn=0.2),
    "segment_two_step": Kernel(_two_step, partition=True, shift=0.1, turn=0.1),
    "keep_inliers": Kernel(lambda xyz: (keep_inliers(xyz, n_neighbors=8, std_ratio=2.0),)),
    "compute_supervoxel_features": Kernel(supervoxel_features, turn=None, minimum=1, shift=0.02, tolerance=0.15),
    "project_points": Kernel(_pixels, turn=None),
    "visible_points": Kernel(partial(_seen, DepthBuffer()), turn=0.01),
    "visible_points by their hull": Kernel(partial(_seen, HiddenPointRemoval()), shift=0.01, turn=0.1, permute=0.005),
    "stages of a model": Kernel(model_stages, partition=True, shift=0.2, turn=None, permute=0.05, minimum=1),
}
