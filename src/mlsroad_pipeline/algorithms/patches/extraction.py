"""Patches of Luo et al. 2016, section III-A: the leaves of an octree, each described by shape, colour and height."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.algorithms.features.normals import compute_normals
from mlsroad_pipeline.algorithms.geometry.voxels.grid import VoxelGrid, build_voxel_grid

UNKNOWN = -1
"""Label of patches whose class is not known, and patch of points that are in none."""

logger = logging.getLogger(__name__)

_COLUMNS: dict[str, tuple[type[np.generic], int]] = {
    "fpfh": (np.float32, 2),
    "rgb": (np.float32, 2),
    "height": (np.float32, 1),
    "centroid": (np.float64, 2),
    "scene": (np.int32, 1),
    "label": (np.int16, 1),
}


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches of one scene or of several, one row each.

    Parameters
    ----------
    fpfh : array-like of shape (n, d)
        Histogram of each patch; kept as float32. What `extract_patches` makes sums to 1, or to 0 for a patch without
        any neighbouring support point.
    rgb : array-like of shape (n, 3) or None
        Mean colour in [0, 1], kept as float32; None where the survey has no colour.
    height : array-like of shape (n,)
        Height of the centroid above the local ground in metres, kept as float32.
    centroid : array-like of shape (n, 3)
        Mean of the patch's points in metres, kept as float64.
    scene : array-like of int, shape (n,)
        Number of the scene that the patch is from, kept as int32.
    label : array-like of int, shape (n,)
        Class of the patch, kept as int16; `UNKNOWN` (-1) where it is not known.

    Raises
    ------
    DataError
        If a column has another shape or length, or a value is NaN or infinite.
    """

    fpfh: NDArray[np.float32]
    rgb: NDArray[np.float32] | None
    height: NDArray[np.float32]
    centroid: NDArray[np.float64]
    scene: NDArray[np.int32]
    label: NDArray[np.int16]

    def __post_init__(self) -> None:
        n = len(np.asarray(self.fpfh))
        for name, (dtype, n_dimensions) in _COLUMNS.items():
            if name == "rgb" and self.rgb is None:
                continue
            values = np.ascontiguousarray(getattr(self, name), dtype=dtype)
            width = values.shape[1:] if name == "fpfh" else (3,) * (n_dimensions - 1)
            if values.ndim != n_dimensions or values.shape != (n, *width):
                raise DataError(f"{name} of {n} patches must have shape {(n, *width)}, got {values.shape}")
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values.reshape(n, -1)).all(axis=1))[0])
                raise DataError(f"{name} of patch {row} is not finite: {values[row].tolist()}")
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        """Return the number of patches."""
        return len(self.height)

    def take(self, rows: NDArray) -> Patches:
        """Return the patches at an index array or under a boolean mask."""
        return Patches.from_arrays({name: values[rows] for name, values in self.to_arrays().items()})

    def with_columns(self, **columns: Any) -> Patches:
        """Return the same patches with columns replaced, such as `label`, or `rgb` by None."""
        return replace(self, **columns)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the patches as named plain arrays, without `rgb` where there is no colour."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: values for name, values in found.items() if values is not None}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> Patches:
        """Rebuild patches from the arrays of `to_arrays`.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays; other entries are ignored.

        Returns
        -------
        Patches
            The patches.

        Raises
        ------
        DataError
            If an array other than `rgb` is missing, or the arrays do not fit together.
        """
        missing = [name for name in _COLUMNS if name != "rgb" and name not in arrays]
        if missing:
            raise DataError(f"the arrays of patches lack {', '.join(missing)}")
        columns: dict[str, Any] = {name: arrays.get(name) for name in _COLUMNS}
        return cls(**columns)


def join_patches(parts: Sequence[Patches]) -> Patches:
    """Join patches of several scenes, one after another.

    Parameters
    ----------
    parts : sequence of Patches
        At least one; their histograms have one length.

    Returns
    -------
    Patches
        All patches. They have colour only where every part has it.

    Raises
    ------
    DataError
        If there is no part, or the histograms differ in length.
    """
    if not parts:
        raise DataError("no patches to join")
    widths = sorted({part.fpfh.shape[1] for part in parts})
    if len(widths) > 1:
        raise DataError(f"patches with histograms of {' and '.join(map(str, widths))} bins cannot be joined")
    coloured = all(part.rgb is not None for part in parts)
    columns = {name: [getattr(part, name) for part in parts] for name in _COLUMNS if coloured or name != "rgb"}
    return Patches.from_arrays({name: np.concatenate(values) for name, values in columns.items()})


@dataclass(frozen=True)
class PatchParameters:
    """How patches are cut and described, and how points take their labels.

    Parameters
    ----------
    patch_size : float, default 0.2
        Edge of a leaf of the octree, L, metres (luo2016: 0.2). Larger ones are fewer and mix what lies side by side.
    voxel_size : float, default 0.1
        Edge of the voxels whose centroids are the support points of the histograms, metres; a whole number of them
        fills a leaf. Smaller ones follow finer shape; time grows with their number times their neighbours.
    normal_radius : float, default 0.3
        Neighbourhood of the normals, metres.
    fpfh_radius : float, default 0.8
        Neighbourhood of the histograms, metres. Larger ones see more of an object and more of what is beside it.
    n_bins : int, default 4
        Bins of each pair feature (luo2016: 16 values in all; read as 4 features of 4 bins).
    use_distance : bool, default True
        Whether the distance is a pair feature beside the three angles.
    area_radius : float, default 0.3
        Distance up to which patches vote on a point's label, R_area, metres (luo2016: 0.3).

    Raises
    ------
    ParameterError
        If a length is not above zero, `n_bins` is not from 1 to 255, or voxels do not fill a leaf.
    """

    patch_size: float = 0.2
    voxel_size: float = 0.1
    normal_radius: float = 0.3
    fpfh_radius: float = 0.8
    n_bins: int = 4
    use_distance: bool = True
    area_radius: float = 0.3

    def __post_init__(self) -> None:
        for name in ("patch_size", "voxel_size", "normal_radius", "fpfh_radius", "area_radius"):
            check_positive(getattr(self, name), f"patches.{name}")
        if not 1 <= self.n_bins <= 255:
            raise ParameterError(f"patches.n_bins must be from 1 to 255, got {self.n_bins!r}")
        ratio = self.patch_size / self.voxel_size
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise ParameterError(
                f"patches.patch_size must be a whole number of times patches.voxel_size, "
                f"got {self.patch_size!r} and {self.voxel_size!r}"
            )


@dataclass(frozen=True, eq=False)
class PatchScene:
    """The patches of one scene, and how they lie in it.

    Attributes
    ----------
    patches : Patches
        The patches, numbered by place.
    patch_of_point : ndarray of int32, shape (n,)
        Patch of each point; `UNKNOWN` (-1) for points that take no part.
    edges : ndarray of int32, shape (m, 2)
        Pairs of patches whose leaves share a face, an edge or a corner, each pair once, the lower number first.
    """

    patches: Patches
    patch_of_point: NDArray[np.int32]
    edges: NDArray[np.int32]


def extract_patches(
    cloud: PointCloud,
    *,
    height: ArrayLike,
    parameters: PatchParameters | None = None,
    keep: ArrayLike | None = None,
    scene: int = 0,
) -> PatchScene:
    """Cut a scene into patches and describe each (Luo et al. 2016, section III-A).

    Patches are the occupied leaves of an octree whose corners are multiples of the leaf's size in world coordinates, so
    that scenes of one survey agree on them. Support points of the histograms are the centroids of smaller voxels; a
    patch takes the mean over its voxels, scaled to sum 1.

    Parameters
    ----------
    cloud : PointCloud
        The scene; its column `rgb` gives the colours where it is there.
    height : array-like of shape (n,)
        Height of each point above the local ground, metres, as `find_ground` gives it. Where all are NaN, because no
        point is ground, heights are measured from the scene's lowest point, with a warning.
    parameters : PatchParameters, optional
        Sizes and radii; the defaults where None.
    keep : array-like of bool, shape (n,), optional
        Which points take part; all by default.
    scene : int, default 0
        Number of the scene, stored with every patch.

    Returns
    -------
    PatchScene
        Patches without labels, patch of each point, and edges.

    Raises
    ------
    DataError
        If no point takes part, a coordinate is not finite, or a column has another length.
    """
    sizes = parameters if parameters is not None else PatchParameters()
    used = np.ones(len(cloud), np.bool_) if keep is None else check_column(keep, len(cloud), "keep").astype(np.bool_)
    if not used.any():
        raise DataError(f"{cloud.source}: no points to make patches of")
    everything = bool(used.all())
    xyz = cloud.xyz if everything else cloud.xyz[used]
    heights = _known_heights(xyz, check_column(height, len(cloud), "height")[used], cloud.source)
    anchor = -np.mod(np.asarray(cloud.origin, np.float64), sizes.patch_size)
    voxels = build_voxel_grid(xyz, voxel_size=sizes.voxel_size, anchor=anchor)
    # Centres of voxels lie well inside their leaf, so that rounding cannot put one into the leaf beside it.
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
        logger.warning("%s has no ground: heights of patches are measured from its lowest point", source)
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
    """Return the mean of each leaf's points, from the means of its voxels."""
    weighted = voxels.local_centroids * voxels.counts[:, None]
    sums = [np.bincount(leaf_of_voxel, weights=weighted[:, axis], minlength=len(counts)) for axis in range(3)]
    return voxels.origin + np.stack(sums, axis=1) / counts[:, None] * voxels.voxel_size


def _describe_leaves(
    voxels: VoxelGrid, leaf_of_voxel: NDArray[np.int32], n_leaves: int, sizes: PatchParameters
) -> NDArray[np.float32]:
    """Return the mean histogram of each leaf's voxels, scaled to sum 1; 0 where none of them has a neighbour."""
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
