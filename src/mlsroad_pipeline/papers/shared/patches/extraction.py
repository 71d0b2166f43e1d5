"""Octree patches with shape, colour and height descriptors (Luo et al. 2016, III-A), and their stored arrays."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NotRequired, Protocol, Self, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.algorithms.features.normals import compute_normals
from mlsroad_pipeline.algorithms.geometry.voxels.grid import VoxelGrid, build_voxel_grid
from mlsroad_pipeline.papers.shared.patches.table import UNKNOWN, Patches

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PatchParameters:
    """Parameters of patch extraction and of the votes for point labels."""

    # Edge L of an octree leaf, metres (luo2016: 0.2). Larger patches are fewer and mix adjacent objects.
    patch_size: float = 0.2
    # Edge of the voxels whose centroids are the support points of the histograms, metres; divides `patch_size`. Smaller
    # voxels resolve finer shape. Time grows with the number of voxels times that of their neighbours.
    voxel_size: float = 0.1
    normal_radius: float = 0.3  # Search radius of the normals, metres
    # Search radius of the histograms, metres. Larger values include more context and more adjacent objects.
    fpfh_radius: float = 0.8
    n_bins: int = 4  # Bins of each pair feature (luo2016: 16 values in total, read as 4 features of 4 bins)
    use_distance: bool = True  # Whether to use the distance as a fourth pair feature beside the three angles
    area_radius: float = 0.3  # Radius R_area within which patches vote for the label of a point, metres (luo2016: 0.3)

    def __post_init__(self) -> None:
        for name in ("patch_size", "voxel_size", "normal_radius", "fpfh_radius", "area_radius"):
            check_positive(getattr(self, name), f"patches.{name}")
        if not 1 <= self.n_bins <= 255:
            raise ParameterError(f"patches.n_bins must be from 1 to 255, got {self.n_bins!r}")
        ratio = self.patch_size / self.voxel_size
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise ParameterError(
                f"patches.patch_size must be an integer multiple of patches.voxel_size, "
                f"got {self.patch_size!r} and {self.voxel_size!r}"
            )


@dataclass(frozen=True, eq=False)
class PatchScene:
    """Patches of one scene, with the relation of patches to points and to each other."""

    patches: Patches  # The patches
    patch_of_point: NDArray[np.int32]  # Patch of each point; `UNKNOWN` (-1) for excluded points
    edges: NDArray[np.int32]  # Pairs of 26-adjacent leaves, each pair once, the lower index first


def extract_patches(
    cloud: PointCloud,
    *,
    height: ArrayLike,
    parameters: PatchParameters | None = None,
    keep: ArrayLike | None = None,
    scene: int = 0,
) -> PatchScene:
    """Extract the patches of a scene and their descriptors (Luo et al. 2016, section III-A).

    Patches are the occupied leaves of an octree. Leaf corners are multiples of the leaf size in world coordinates, so
    that overlapping scenes of a survey share them.
    """
    sizes = parameters if parameters is not None else PatchParameters()
    used = np.ones(len(cloud), np.bool_) if keep is None else check_column(keep, len(cloud), "keep").astype(np.bool_)
    if not used.any():
        raise DataError(f"{cloud.source}: no points to extract patches from")
    everything = bool(used.all())
    xyz = cloud.xyz if everything else cloud.xyz[used]
    heights = _known_heights(xyz, check_column(height, len(cloud), "height")[used], cloud.source)
    anchor = -np.mod(np.asarray(cloud.origin, np.float64), sizes.patch_size)
    voxels = build_voxel_grid(xyz, voxel_size=sizes.voxel_size, anchor=anchor)
    # Voxel centres lie well inside their leaf: rounding cannot move one into an adjacent leaf.
    centres = voxels.origin + (voxels.coords + 0.5) * sizes.voxel_size
    leaves = build_voxel_grid(centres, voxel_size=sizes.patch_size, anchor=anchor)
    owner = leaves.voxel_of_point[voxels.voxel_of_point]
    n, counts = len(leaves), np.bincount(owner, minlength=len(leaves)).astype(np.float64)
    colours = cloud.get("rgb")
    patches = Patches(
        fpfh=_describe_leaves(voxels, leaves.voxel_of_point, n, sizes),
        rgb=None if colours is None else _means(colours[used], owner, counts) / np.float32(255.0),
        height=_means(heights, owner, counts),
        centroid=_leaf_centroids(voxels, leaves.voxel_of_point, counts),
        scene=np.full(n, scene, np.int32),
        label=np.full(n, UNKNOWN, np.int16),
    )
    patch_of_point = owner if everything else np.full(len(cloud), UNKNOWN, np.int32)
    patch_of_point[used] = owner
    return PatchScene(patches, patch_of_point, _edges(leaves))


def _known_heights(xyz: NDArray[np.floating], height: NDArray, source: str) -> NDArray[np.float64]:
    heights = height.astype(np.float64)
    missing = np.isnan(heights)
    if missing.all():
        logger.warning("%s has no ground points: heights of patches are measured from the lowest point", source)
        return xyz[:, 2].astype(np.float64) - float(xyz[:, 2].min())
    if missing.any():
        raise DataError(f"{source}: height is NaN for {int(missing.sum())} of {len(heights)} points")
    return heights


def _means(values: NDArray, owner: NDArray[np.int32], counts: NDArray[np.float64]) -> NDArray[np.float32]:
    columns = values.reshape(len(values), -1).T
    sums = [np.bincount(owner, weights=column, minlength=len(counts)) for column in columns]
    means = np.stack(sums, axis=1) / counts[:, None]
    return means.reshape(len(counts), *values.shape[1:]).astype(np.float32)


def _leaf_centroids(
    voxels: VoxelGrid, leaf_of_voxel: NDArray[np.int32], counts: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean of the points of each leaf, computed from the means of its voxels."""
    weighted = voxels.local_centroids * voxels.counts[:, None]
    sums = [np.bincount(leaf_of_voxel, weights=weighted[:, axis], minlength=len(counts)) for axis in range(3)]
    return voxels.origin + np.stack(sums, axis=1) / counts[:, None] * voxels.voxel_size


def _describe_leaves(
    voxels: VoxelGrid, leaf_of_voxel: NDArray[np.int32], n_leaves: int, sizes: PatchParameters
) -> NDArray[np.float32]:
    """Return the mean histogram of the voxels of each leaf, normalised to sum 1; 0 without neighbours."""
    support = voxels.local_centroids * voxels.voxel_size
    normals = compute_normals(support, radius=sizes.normal_radius)
    histograms = compute_fpfh(
        support, normals, radius=sizes.fpfh_radius, n_bins=sizes.n_bins, use_distance=sizes.use_distance
    )
    sums = np.stack([np.bincount(leaf_of_voxel, weights=h, minlength=n_leaves) for h in histograms.T], axis=1)
    total = sums.sum(axis=1, keepdims=True)
    shares: NDArray[np.float64] = sums / np.where(total > 0, total, 1.0)
    return shares.astype(np.float32)


def _edges(leaves: VoxelGrid) -> NDArray[np.int32]:
    indptr, indices = leaves.neighbors()
    rows = np.repeat(np.arange(len(leaves), dtype=np.int32), np.diff(indptr))
    once = rows < indices
    return np.stack([rows[once], indices[once]], axis=1)


class ScenePatches(TypedDict):
    """Patches of a scene as stored arrays: the columns of `Patches`, and their relation to the points.

    `patch_of_point` is -1 for outliers; `edges` has each pair of adjacent patches once.
    """

    fpfh: NDArray[np.float32]
    rgb: NotRequired[NDArray[np.float32]]
    height: NDArray[np.float32]
    centroid: NDArray[np.float64]
    scene: NDArray[np.int32]
    label: NDArray[np.int16]
    patch_of_point: NDArray[np.int32]
    edges: NDArray[np.int32]


class PatchLabels(TypedDict):
    """Classes (-1 without labelled core points) and stations in metres of the patches of a training scene."""

    label: NDArray[np.int16]
    station: NDArray[np.float64]


class PatchClassifier(Protocol):
    """Classifier of patches."""

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.floating]:
        """Return the probability of every class of the scheme for the patches of one scene, with or without colour."""

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays."""

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from the arrays of `to_arrays`."""


@dataclass(frozen=True)
class PatchStages:
    """Parameters of the stages before a classifier; a model stores them, and new surveys are prepared with the same."""

    ground: GroundParameters
    patches: PatchParameters
