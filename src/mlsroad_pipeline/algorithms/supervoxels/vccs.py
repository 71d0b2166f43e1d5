"""Voxel cloud connectivity segmentation: supervoxels that grow over touching voxels (Papon et al. 2013)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.geometry.cell_grid import check_threads
from mlsroad_pipeline.algorithms.geometry.voxels import VoxelGrid, build_voxel_grid
from mlsroad_pipeline.algorithms.geometry.voxels.grid import run_chunks
from mlsroad_pipeline.algorithms.supervoxels import _growth, _partition, _seeds
from mlsroad_pipeline.algorithms.supervoxels._features import compute_normals, voxel_features

LEVELS_PER_SEED_RESOLUTION = 1.8  # voxels per seed resolution times this, less one, is the number of levels grown
COMPANY = 0.05  # share of a planar disc of radius seed_resolution / 2 that a seed needs filled
SLIVER = 0.25  # share of a seed cell's voxels up to which a touched seed is a sliver

Neighbors = tuple[NDArray[np.int64], NDArray[np.int32]]


@dataclass(frozen=True, eq=False)
class Supervoxels:
    """A partition of a cloud into supervoxels.

    Attributes
    ----------
    labels : ndarray of shape (n,), int32
        Supervoxel of each point, 0 to s - 1, numbered as the points come.
    centroids : ndarray of shape (s, 3), float64
        Mean of the voxel centroids of each supervoxel, metres, in the coordinates of the points. Voxels count alike,
        so that the density of the scan does not pull.
    normals : ndarray of shape (s, 3), float64
        Unit mean direction of the voxel normals of each supervoxel, turned to the upper side (z, then y, then x, is
        not negative); NaN where no voxel has a normal, as in pieces that are a point or a straight line.
    adjacency : scipy.sparse.csr_array of shape (s, s), int8
        1 where a voxel of one supervoxel shares a face, an edge or a corner with one of the other; symmetric, sorted,
        without self loops.
    voxel_labels : ndarray of shape (v,), int32
        Supervoxel of each voxel.
    grid : VoxelGrid
        The v voxels: which points they hold, and where they are.
    n_islands : int
        How many of the supervoxels no seed reached: connected islands of voxels, too small for a seed of their own.
        PCL leaves their points without a label.
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
    """Cut a point cloud into supervoxels: compact, connected, and not across edges as far as the voxels tell.

    The points are sorted into voxels; one voxel in each cell of a coarser seed grid starts a supervoxel; and each
    supervoxel grows over touching voxels, one level at a time, every voxel going to the nearest supervoxel beside it by

        D^2 = w_c D_c^2 + w_s D_s^2 / (3 R^2) + w_n D_n^2,

    with D_c the distance in RGB scaled to [0, 1], D_s that between voxel and supervoxel centroid, R the seed
    resolution, and D_n = 1 - |n . n'|. As in the Point Cloud Library there are int(1.8 R / voxel_size) - 1 levels, and
    no refinement unless asked for. The method page says where this departs from the paper and from that library.

    The partition does not depend on the order of the points or on the number of threads, nor on where the cloud lies
    (up to the rounding of the coordinates). Each supervoxel is connected over the 26 neighbours of its voxels.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres.
    rgb : array-like of shape (n, 3), uint8, optional
        Colours. Without them the colour term is left out.
    normals : array-like of shape (n, 3), optional
        Normals of the points, of any length and sign, NaN where undefined. Without them the normals of the voxels are
        fitted to the voxels up to two steps away.
    voxel_size : float
        Edge of a voxel, metres: no border is finer than this. Smaller costs time and memory. tomic2019 takes 0.2.
    seed_resolution : float
        Edge of a seed cell, metres, at least `voxel_size`: about the width of a supervoxel. tomic2019 takes 0.6.
    colour_weight, spatial_weight, normal_weight : float
        Weights w_c, w_s and w_n, not negative, not all zero. More colour follows paint and leaves, more space gives
        rounder pieces, more normal follows edges. tomic2019 has w_c = 0.
    distance : {"papon", "tomic"}
        Whether D_s^2 is divided by 3 R^2 (Papon et al. 2013, equation 1) or by R^2 (tomic2019, equation 1 as printed).
    n_refinements : int, default 0
        How often normals are fitted again inside each supervoxel, its voxel nearest to its centroid becomes the seed,
        and all is grown anew. Two or three give more compact pieces, at the price of as many growths.
    anchor : array-like of shape (3,), optional
        A corner of the voxel grid; the centre of the bounding box by default.
    n_threads : int, default 1
        Threads to use; the result does not depend on it.

    Returns
    -------
    Supervoxels
        Labels of the points, centroids, normals and adjacency of the supervoxels.

    Raises
    ------
    DataError
        If `xyz` is not of shape (n, 3), is empty, or has NaN or infinite coordinates; if `rgb` or `normals` have
        another length; if `rgb` is not uint8.
    ParameterError
        If a size is not positive and finite, `seed_resolution` is less than `voxel_size`, a weight is negative or not
        finite or all are zero, `distance` is unknown, `n_refinements` is negative, `n_threads` is less than 1, or the
        voxels are too small for the cloud's extent.

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
    """Return the weights of the squared spatial, normal and colour distances, normalisation included."""
    given = {"colour_weight": colour, "spatial_weight": spatial, "normal_weight": normal}
    for name, value in given.items():
        if not np.isfinite(value) or value < 0:
            raise ParameterError(f"{name} must be a finite number >= 0, got {value!r}")
    if not any(given.values()):
        raise ParameterError("colour_weight, spatial_weight and normal_weight must not all be 0")
    divisors = {"papon": 3.0 * seed_in_voxels**2, "tomic": seed_in_voxels**2}
    if distance not in divisors:
        raise ParameterError(f"distance must be one of {sorted(divisors)}, got {distance!r}")
    return np.array([spatial / divisors[distance], normal, colour], np.float64)


@dataclass(frozen=True, eq=False)
class _Growth:
    """What stays the same while supervoxels grow; lengths are in voxel sizes."""

    features: NDArray[np.float64]
    neighbors: Neighbors
    weights: NDArray[np.float64]
    seed_size: float
    n_threads: int

    def choose_seeds(self, grid: VoxelGrid) -> NDArray[np.int32]:
        """Return the voxels that start supervoxels, in the order of the voxels."""
        anchor = self.features[_seeds.first_in_octree(grid.coords), :3].copy()
        seeds = _seeds.nearest_to_cell_centres(self.features, anchor, self.seed_size)
        radius = self.seed_size / 2
        needed = int(COMPANY * np.pi * radius**2) + 1
        owner = np.full(len(self.features), -1, np.int32)
        seeds = _seeds.spread_out(seeds, self.features, *self.neighbors, radius, needed, owner)
        owner = _growth.first_level(seeds, self.features, self.weights, *self.neighbors)
        return _seeds.drop_slivers(seeds, *self.neighbors, owner, SLIVER * self.seed_size**3 + 1e-9)

    def grow(self, seeds: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the supervoxel of each voxel after all levels, -1 where none came, and the supervoxels' features."""
        # The small addend keeps 1.8 * 0.5 / 0.1 at the 9 that it is.
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
        """Return the owners one level later."""
        grown = np.empty_like(owner)
        run_chunks(
            lambda a, b: _growth.grow_level(self.features, models, self.weights, *self.neighbors, owner, a, b, grown),
            len(owner),
            self.n_threads,
        )
        return grown

    def complete(self, owner: NDArray[np.int32], models: NDArray[np.float64]) -> int:
        """Make every supervoxel connected and give every voxel one, in place; return the number of islands."""
        free = _growth.release_fragments(*self.neighbors, owner, len(models))
        left = _growth.flood(free, self.features, models, self.weights, *self.neighbors, owner)
        return int(_growth.number_islands(left, *self.neighbors, owner, len(models)))


def _summarise(
    grid: VoxelGrid,
    features: NDArray[np.float64],
    neighbors: Neighbors,
    owner: NDArray[np.int32],
    n_islands: int,
    n_threads: int,
) -> Supervoxels:
    """Number the supervoxels by first point and describe them."""
    n_owners = int(owner.max()) + 1
    labels, number, n = _partition.number_by_first_point(grid.voxel_of_point, owner, n_owners)
    start, group = _partition.group_voxels(owner, n_owners)
    centroids, normals = _partition.describe(features, start, group, number, n)
    parts = run_chunks(
        lambda a, b: _partition.touching_owners(*neighbors, owner, number, start, group, a, b), n_owners, n_threads
    )
    lengths, rows = (np.concatenate([part[k] for part in parts]) if len(parts) > 1 else parts[0][k] for k in (0, 1))
    indptr, indices = _partition.order_rows(number, lengths, rows, n)
    adjacency = scipy.sparse.csr_array((np.ones(len(indices), np.int8), indices, indptr), shape=(n, n))
    return Supervoxels(
        labels, grid.origin + centroids * grid.voxel_size, normals, adjacency, number[owner], grid, n_islands
    )
