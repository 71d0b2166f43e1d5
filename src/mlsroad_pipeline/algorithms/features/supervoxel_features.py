"""Features of supervoxels: shape, orientation, height and radiometry, with detrending."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.columns import (
    COLUMN_FEATURES,
    build_columns,
    describe_columns,
    describe_footprints,
    footprint_feature_names,
)
from mlsroad_pipeline.algorithms.features.detrending import detrend as remove_tendency
from mlsroad_pipeline.algorithms.features.eigen import SHAPE_FEATURES
from mlsroad_pipeline.algorithms.features.normals import ORIENTATION_FEATURES, describe_shape
from mlsroad_pipeline.algorithms.features.supervoxel_moments import (
    COLOUR_FEATURES,
    GROUND_HEIGHT_FEATURES,
    INTENSITY_FEATURES,
    OWN_HEIGHT_FEATURES,
    SupervoxelMoments,
    describe_colour,
    describe_ground_height,
    describe_intensity,
    describe_own_height,
    sum_moments,
)
from mlsroad_pipeline.algorithms.features.surroundings import ball_feature_names, describe_balls

Region = Literal["own", "neighborhood", "both"]
Blocks = list[tuple[tuple[str, ...], NDArray[np.float32]]]


@dataclass(frozen=True)
class SupervoxelFeatures:
    """Features of supervoxels, one row a supervoxel."""

    values: NDArray[np.float32]  # Features; NaN if undefined
    names: tuple[str, ...]  # Names of the features
    centroids: NDArray[np.float64]  # Mean coordinates of the points of each supervoxel, metres
    counts: NDArray[np.int64]  # Points of each supervoxel


def check_supervoxels(labels: ArrayLike, adjacency: csr_array, n_points: int) -> NDArray[np.int32]:
    """Validate supervoxel labels and adjacency; return the labels as int32."""
    array = check_column(labels, n_points, "labels")
    if not np.issubdtype(array.dtype, np.integer):
        raise DataError(f"labels must be integers, got {array.dtype}")
    s = adjacency.shape[0]
    if adjacency.shape != (s, s):
        raise DataError(f"adjacency must be square, got {adjacency.shape}")
    if n_points and not 0 <= int(array.min()) <= int(array.max()) < s:
        raise DataError(f"labels must be in 0..{s - 1} (adjacency is {s} x {s}), got {array.min()}..{array.max()}")
    empty = np.flatnonzero(np.bincount(array, minlength=s) == 0)
    if len(empty):
        raise DataError(f"{len(empty)} of {s} supervoxels have no point, the first is {empty[0]}")
    if np.any(adjacency.diagonal()):
        raise DataError(f"adjacency joins supervoxel {np.flatnonzero(adjacency.diagonal())[0]} with itself")
    return np.ascontiguousarray(array, dtype=np.int32)


def _shape_and_orientation(moments: SupervoxelMoments) -> NDArray[np.float32]:
    return describe_shape(moments.covariances, moments.counts.astype(np.float32))


def compute_supervoxel_features(
    xyz: ArrayLike,
    labels: ArrayLike,
    adjacency: csr_array,
    *,
    height_above_ground: ArrayLike | None = None,
    rgb: ArrayLike | None = None,
    intensity: ArrayLike | None = None,
    detrend: bool = True,
    region: Region = "both",
    column_size: float = 0.5,
    relief_radius: float = 5.0,
    ball_radii: Sequence[float] = (0.5, 1.0, 2.0),
    ball_voxel_size: float = 0.2,
    footprint_radii: Sequence[float] = (1.5, 3.0, 6.0),
    ball_voxels: NDArray[np.float64] | None = None,
) -> SupervoxelFeatures:
    """Compute the features of supervoxels (Tomic et al. 2019, section 2.1, equations 2 and 3).

    V_S consists of the seven eigenvalue features, orientation, height and, if available, height above ground, colour
    and intensity.
    """
    points = check_xyz(xyz, minimum=1)
    owners = check_supervoxels(labels, adjacency, len(points))
    if region not in ("own", "neighborhood", "both"):
        raise ParameterError(f"region must be 'own', 'neighborhood' or 'both', got {region!r}")
    sizes = {"column_size": column_size, "relief_radius": relief_radius, "ball_voxel_size": ball_voxel_size}
    sizes |= {f"ball_radii[{i}]": radius for i, radius in enumerate(ball_radii)}
    sizes |= {f"footprint_radii[{i}]": radius for i, radius in enumerate(footprint_radii)}
    for name, value in sizes.items():
        check_positive(value, name)
    own, around = sum_moments(points, owners, adjacency.shape[0], None if region == "own" else adjacency)
    raster = build_columns(points, cell_size=column_size, relief_radius=relief_radius)
    blocks, context = _shape_blocks(own, around, region)
    blocks.append((OWN_HEIGHT_FEATURES, describe_own_height(own)))
    blocks.append((COLUMN_FEATURES, describe_columns(own.centroids, raster)))
    blocks += _attribute_blocks(owners, adjacency.shape[0], height_above_ground, rgb, intensity)
    if ball_radii:
        balls = describe_balls(points, own.centroids, radii=ball_radii, voxel_size=ball_voxel_size, voxels=ball_voxels)
        context.append((ball_feature_names(ball_radii), balls))
    for radius in footprint_radii:
        context.append((footprint_feature_names(radius), describe_footprints(own.centroids, raster, radius=radius)))
    return _assemble(blocks, context, adjacency, own, detrend=detrend)


def _shape_blocks(own: SupervoxelMoments, around: SupervoxelMoments | None, region: Region) -> tuple[Blocks, Blocks]:
    """Return the shape and orientation features to detrend, and those of the context."""
    names = (*SHAPE_FEATURES, *ORIENTATION_FEATURES)
    blocks: Blocks = [] if region == "neighborhood" else [(names, _shape_and_orientation(own))]
    if around is None:
        return blocks, []
    wider: Blocks = [(tuple(f"{name}_neighborhood" for name in names), _shape_and_orientation(around))]
    return (blocks, wider) if region == "both" else (wider, [])


def _attribute_blocks(
    owners: NDArray[np.int32],
    n_supervoxels: int,
    height_above_ground: ArrayLike | None,
    rgb: ArrayLike | None,
    intensity: ArrayLike | None,
) -> Blocks:
    """Return the features of optional attributes."""
    blocks: Blocks = []
    if height_above_ground is not None:
        heights = check_column(height_above_ground, len(owners), "height_above_ground")
        blocks.append((GROUND_HEIGHT_FEATURES, describe_ground_height(heights, owners, n_supervoxels)))
    if rgb is not None:
        colours = check_column(rgb, len(owners), "rgb", 3)
        if colours.dtype != np.uint8:
            raise DataError(f"rgb must be uint8, got {colours.dtype}")
        blocks.append((COLOUR_FEATURES, describe_colour(colours, owners, n_supervoxels)))
    if intensity is not None:
        intensities = check_column(intensity, len(owners), "intensity")
        blocks.append((INTENSITY_FEATURES, describe_intensity(intensities, owners, n_supervoxels)))
    return blocks


def _assemble(
    blocks: Blocks, context: Blocks, adjacency: csr_array, moments: SupervoxelMoments, *, detrend: bool
) -> SupervoxelFeatures:
    """Join the blocks and append the detrended features of all but the context."""
    names = tuple(name for block_names, _ in (*blocks, *context) for name in block_names)
    values = np.hstack([block for _, block in (*blocks, *context)])
    if detrend:
        width = sum(block.shape[1] for _, block in blocks)
        values = np.hstack([values, remove_tendency(np.ascontiguousarray(values[:, :width]), adjacency)])
        names = (*names, *(f"{name}_detrended" for name in names[:width]))
    return SupervoxelFeatures(np.ascontiguousarray(values), names, moments.centroids, moments.counts)
