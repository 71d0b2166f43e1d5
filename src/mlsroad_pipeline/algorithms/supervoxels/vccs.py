"""Voxel cloud connectivity segmentation (VCCS, Papon et al. 2013)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_ranges
from mlsroad_pipeline.algorithms.geometry.voxels import VoxelGrid, build_voxel_grid
from mlsroad_pipeline.algorithms.supervoxels import _growth, _partition, _seeds
from mlsroad_pipeline.algorithms.supervoxels._features import compute_normals, voxel_features

LEVELS_PER_SEED_RESOLUTION = 1.8  # levels = int(1.8 * seed resolution in voxels) - 1
COMPANY = 0.05  # minimum filled fraction of a planar disc of radius seed_resolution / 2 around a seed
SLIVER = 0.25  # maximum fraction of the voxels of a seed cell of a sliver

Neighbors = tuple[NDArray[np.int64], NDArray[np.int32]]


@dataclass(frozen=True, eq=False)
class Supervoxels:
    """Partition of a cloud into supervoxels.

    Attributes
    ----------
    labels : ndarray of shape (n,), int32
        Supervoxel of each point, 0 to s - 1, numbered by first point.
    centroids : ndarray of shape (s, 3), float64
        Mean of the voxel centroids of each supervoxel, metres, in the coordinates of the points. All voxels have equal
        weight, independent of scan density.
    normals : ndarray of shape (s, 3), float64
        Unit mean direction of the voxel normals of each supervoxel, oriented upwards (z, then y, then x at least 0);
        NaN without normals, as for points and straight lines.
    adjacency : scipy.sparse.csr_array of shape (s, s), int8
        1 for supervoxels with 26-adjacent voxels; symmetric, sorted, without self loops.
    voxel_labels : ndarray of shape (v,), int32
        Supervoxel of each voxel.
    grid : VoxelGrid
        The v voxels.
    n_islands : int
        Number of supervoxels without a seed: connected components of unreached voxels. PCL leaves their points
        unlabelled.
    """

    labels: NDArray[np.int32]
    centroids: NDArray[np.float64]
    normals: NDArray[np.float64]
    adjacency: scipy.sparse.csr_array
    voxel_labels: NDArray[np.int32]
    grid: VoxelGrid
    n_islands: int

    def __len__(self) -> int:
        """Return the number of supervoxels."""
        return len(self.centroids)

    @property
    def voxel_of_point(self) -> NDArray[np.int32]:
        """Voxel of each point, (n,) int32."""
        return self.grid.voxel_of_point


def segment_supervoxels(
    xyz: ArrayLike,
    *,
    rgb: ArrayLike | None = None,
    normals: ArrayLike | None = None,
    voxel_size: float,
    seed_resolution: float,
    colour_weight: float = 0.2,
    spatial_weight: float = 0.4,
    normal_weight: float = 1.0,
    distance: Literal["papon", "tomic"] = "papon",
    n_refinements: int = 0,
    anchor: ArrayLike | None = None,
    n_threads: int = 1,
) -> Supervoxels:
    """Partition a point cloud into compact, connected supervoxels that preserve edges.

    The points are sorted into voxels. One voxel of each cell of a coarser seed grid starts a supervoxel. Supervoxels
    grow over adjacent voxels, level by level; a voxel joins the nearest adjacent supervoxel by

        D^2 = w_c D_c^2 + w_s D_s^2 / (3 R^2) + w_n D_n^2,

    with D_c the distance in RGB scaled to [0, 1], D_s the distance of voxel and supervoxel centroid, R the seed
    resolution, and D_n = 1 - |n . n'|. As in the Point Cloud Library, there are int(1.8 R / voxel_size) - 1 levels, and
    no refinement by default. The method page lists the differences from the paper and from that library.

    The partition is independent of the order of the points, of the threads and of translation (up to rounding of the
    coordinates). Each supervoxel is 26-connected.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres.
    rgb : array-like of shape (n, 3), uint8, optional
        Colours; without them the colour term is omitted.
    normals : array-like of shape (n, 3), optional
        Normals of the points, of any length and sign, NaN if undefined. By default voxel normals are fitted to the
        voxels up to two steps away.
    voxel_size : float
        Edge of a voxel, the resolution of boundaries, metres (tomic2019: 0.2). Smaller voxels cost time and memory.
    seed_resolution : float
        Edge of a seed cell, about the width of a supervoxel, metres, at least `voxel_size` (tomic2019: 0.6).
    colour_weight, spatial_weight, normal_weight : float
        Weights w_c, w_s and w_n, at least 0, not all 0 (tomic2019: w_c = 0). Colour follows paint and leaves, space
        gives rounder supervoxels, normals follow edges.
    distance : {"papon", "tomic"}
        Divisor of D_s^2: 3 R^2 (Papon et al. 2013, equation 1) or R^2 (tomic2019, equation 1 as printed).
    n_refinements : int, default 0
        Number of refinements. Each fits the normals again within supervoxels, takes the voxel nearest to each centroid
        as seed and repeats the growth. Two or three give more compact supervoxels.
    anchor : array-like of shape (3,), optional
        A corner of the voxel grid; by default the centre of the bounding box.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    Supervoxels
        Labels of the points, centroids, normals and adjacency of the supervoxels.

    Raises
    ------
    DataError
        If `xyz` is empty, not (n, 3) or not finite, `rgb` or `normals` have another length, or `rgb` is not uint8.
    ParameterError
        If a size is not positive and finite, `seed_resolution` is below `voxel_size`, a weight is negative or not
        finite, all weights are 0, `distance` is unknown, `n_refinements` is negative, `n_threads` is below 1, or the
        voxels are too small for the extent of the cloud.

    References
    ----------
    Papon, Abramov, Schoeler, Wörgötter: Voxel Cloud Connectivity Segmentation - Supervoxels for Point Clouds.
    CVPR 2013.

    Examples
    --------
    >>> import numpy as np
    >>> blocks = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [5.0, 0.0, 0.0]])
    >>> segment_supervoxels(blocks, voxel_size=0.2, seed_resolution=0.6).labels
    array([0, 0, 1], dtype=int32)
    """
    size, seed = check_positive(voxel_size, "voxel_size"), check_positive(seed_resolution, "seed_resolution")
    if seed < size:
        raise ParameterError(f"seed_resolution {seed_resolution!r} must not be less than voxel_size {voxel_size!r}")
    if not isinstance(n_refinements, int | np.integer) or n_refinements < 0:
        raise ParameterError(f"n_refinements must be an integer >= 0, got {n_refinements!r}")
    weights = _checked_weights(colour_weight, spatial_weight, normal_weight, distance, seed / size)
    threads = check_threads(n_threads)
    grid = build_voxel_grid(xyz, voxel_size=size, anchor=anchor, n_threads=threads)
    neighbors = grid.neighbors(n_threads=threads)
    features = voxel_features(grid, neighbors, rgb, normals, threads)
    if rgb is None:
        weights[2] = 0.0
    growth = _Growth(features, neighbors, weights, seed / size, threads)
    owner, models = growth.grow(growth.choose_seeds(grid))
    for _ in range(n_refinements):
        compute_normals(features, neighbors, owner, threads)
        seeds = _growth.nearest_voxels(features, owner, models)
        owner, models = growth.grow(seeds[seeds >= 0])
    n_islands = growth.complete(owner, models)
    return _summarise(grid, features, neighbors, owner, n_islands, threads)


def _checked_weights(
    colour: float, spatial: float, normal: float, distance: str, seed_in_voxels: float
) -> NDArray[np.float64]:
    """Return the weights of the squared spatial, normal and colour distances, including the normalisation."""
    weights = {"colour_weight": colour, "spatial_weight": spatial, "normal_weight": normal}
    for name, value in weights.items():
        if not np.isfinite(value) or value < 0:
            raise ParameterError(f"{name} must be a finite number >= 0, got {value!r}")
    if not any(weights.values()):
        raise ParameterError("colour_weight, spatial_weight and normal_weight must not all be 0")
    divisors = {"papon": 3.0 * seed_in_voxels**2, "tomic": seed_in_voxels**2}
    if distance not in divisors:
        raise ParameterError(f"distance must be one of {sorted(divisors)}, got {distance!r}")
    return np.array([spatial / divisors[distance], normal, colour], np.float64)


@dataclass(frozen=True, eq=False)
class _Growth:
    """Constants of supervoxel growth; lengths are in voxel sizes."""

    features: NDArray[np.float64]
    neighbors: Neighbors
    weights: NDArray[np.float64]
    seed_size: float
    n_threads: int

    def choose_seeds(self, grid: VoxelGrid) -> NDArray[np.int32]:
        """Return the seed voxels, ascending."""
        anchor = self.features[_seeds.first_in_octree(grid.coords), :3].copy()
        seeds = _seeds.nearest_to_cell_centres(self.features, anchor, self.seed_size)
        radius = self.seed_size / 2
        needed = int(COMPANY * np.pi * radius**2) + 1
        owner = np.full(len(self.features), -1, np.int32)
        seeds = _seeds.spread_out(seeds, self.features, *self.neighbors, radius, needed, owner)
        owner = _growth.first_level(seeds, self.features, self.weights, *self.neighbors)
        return _seeds.drop_slivers(seeds, *self.neighbors, owner, SLIVER * self.seed_size**3 + 1e-9)

    def grow(self, seeds: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the supervoxel of each voxel after all levels (-1 if unreached), and the features of supervoxels."""
        # The addend corrects rounding: 1.8 * 0.5 / 0.1 is 9.
        n_levels = int(LEVELS_PER_SEED_RESOLUTION * self.seed_size + 1e-9) - 1
        models = self.features[seeds]
        owner = _growth.first_level(seeds if n_levels > 0 else seeds[:0], self.features, self.weights, *self.neighbors)
        owner[seeds] = np.arange(len(seeds), dtype=np.int32)
        for level in range(n_levels):
            if level > 0:
                owner = self._level(owner, models)
            models = _growth.update_models(self.features, owner, models)
        return owner, models

    def _level(self, owner: NDArray[np.int32], models: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the owners after the next level."""
        grown = np.empty_like(owner)
        run_ranges(
            lambda a, b: _growth.grow_level(self.features, models, self.weights, *self.neighbors, owner, a, b, grown),
            len(owner),
            self.n_threads,
        )
        return grown

    def complete(self, owner: NDArray[np.int32], models: NDArray[np.float64]) -> int:
        """Make supervoxels connected and assign all voxels, in place; return the number of islands."""
        free = _growth.release_fragments(*self.neighbors, owner, len(models))
        left = _growth.flood(free, self.features, models, self.weights, *self.neighbors, owner)
        return int(_growth.number_unreached(left, *self.neighbors, owner, len(models)))


def _summarise(
    grid: VoxelGrid,
    features: NDArray[np.float64],
    neighbors: Neighbors,
    owner: NDArray[np.int32],
    n_islands: int,
    n_threads: int,
) -> Supervoxels:
    """Number the supervoxels by first point and compute their attributes."""
    n_owners = int(owner.max()) + 1
    labels, number, n = _partition.number_by_first_point(grid.voxel_of_point, owner, n_owners)
    start, group = _partition.group_voxels(owner, n_owners)
    centroids, normals = _partition.describe(features, start, group, number, n)
    parts = run_ranges(
        lambda a, b: _partition.touching_owners(*neighbors, owner, number, start, group, a, b), n_owners, n_threads
    )
    lengths, rows = (np.concatenate([part[k] for part in parts]) if len(parts) > 1 else parts[0][k] for k in (0, 1))
    indptr, indices = _partition.order_rows(number, lengths, rows, n)
    adjacency = scipy.sparse.csr_array((np.ones(len(indices), np.int8), indices, indptr), shape=(n, n))
    return Supervoxels(
        labels, grid.origin + centroids * grid.voxel_size, normals, adjacency, number[owner], grid, n_islands
    )
