"""Features of multiscale spherical neighbourhoods (Thomas et al. 2018, section 3).

The radius of a sphere grows by a constant ratio from scale to scale, and the cloud is subsampled in proportion: spheres
hold about the same number of points on every scale. Lengths are in units of the radius.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.features import sphere_kernels as kernels
from mlsroad_pipeline.algorithms.features.voxel_levels import Cells, find_voxels, spread_owners
from mlsroad_pipeline.algorithms.geometry.cell_grid import run_in_chunks

ATTRIBUTES = ("intensity", "red", "green", "blue")
"""Attributes of points that a neighbourhood summarises."""
MOST_PER_RADIUS = 8
"""Largest number of cells in a radius: wider windows would wrap into the next column."""
_GEOMETRY = (
    "sum", "omnivariance", "eigenentropy", "linearity", "planarity", "sphericity", "curvature", "verticality_1",
    "verticality_3", "moment_1_1", "moment_2_1", "moment_3_1", "moment_1_2", "moment_2_2", "moment_3_2", "vertical_1",
    "vertical_2", "number",
)  # fmt: skip
_COLUMNS = (*_GEOMETRY, *(f"{name}_{what}" for name in ATTRIBUTES for what in ("mean", "variance")))


def sphere_feature_names(n_scales: int) -> list[str]:
    """Return the names of the columns of the table.

    Parameters
    ----------
    n_scales : int
        Number of scales.

    Returns
    -------
    list of str
        ``<feature>_s<scale>``; ``moment_<i>_<k>`` is the absolute moment of order k along eigenvector i.
    """
    return [f"{name}_s{scale}" for scale in range(n_scales) for name in _COLUMNS]


def attribute_columns(n_scales: int, attribute: str) -> NDArray[np.int64]:
    """Return the columns of the table that depend on an attribute.

    Parameters
    ----------
    n_scales : int
        Number of scales.
    attribute : str
        One of `ATTRIBUTES`.

    Returns
    -------
    ndarray of int64
        Their numbers.
    """
    first = len(_GEOMETRY) + 2 * ATTRIBUTES.index(attribute)
    return np.arange(n_scales * len(_COLUMNS)).reshape(n_scales, -1)[:, first : first + 2].ravel()


@dataclass(frozen=True)
class _Scale:
    """Subsampled cloud of one scale, and the voxels of the finest one in its cells."""

    cells: Cells
    order: NDArray[np.int32]
    starts: NDArray[np.int64]
    points: NDArray[np.float64]
    attributes: NDArray[np.float64]
    radius: float


@dataclass(frozen=True)
class SpherePyramid:
    """Subsampled clouds of all scales; made by `find_spheres`.

    Attributes
    ----------
    owner : ndarray of int32, shape (n,)
        Voxel of the finest subsampling of each point.
    scales : tuple of _Scale
        The subsampled clouds, finest first.
    places : ndarray of int64
        Columns of the present attributes after those of the geometry.
    reach : int
        Cells from the centre of a sphere to its end.
    """

    owner: NDArray[np.int32]
    scales: tuple[_Scale, ...]
    places: NDArray[np.int64]
    reach: int

    def __len__(self) -> int:
        """Return the number of voxels."""
        return len(self.scales[0].points)

    def describe(self, voxels: NDArray[np.integer], *, n_threads: int = 1) -> NDArray[np.float32]:
        """Compute the features of voxels.

        Parameters
        ----------
        voxels : ndarray of int, shape (q,)
            Distinct voxels.
        n_threads : int, default 1
            Threads; the result does not depend on it.

        Returns
        -------
        ndarray of float32, shape (q, f)
            Columns of `sphere_feature_names`. NaN: attributes that are missing; shapes and absolute moments of fewer
            than three points.
        """
        target = np.full(len(self), -1, np.int32)
        target[voxels] = np.arange(len(voxels), dtype=np.int32)
        table = np.full((len(voxels), len(self.scales) * len(_COLUMNS)), np.nan, np.float32)
        queries = self.scales[0].points
        for number, scale in enumerate(self.scales):
            describe = partial(
                kernels.describe_spheres, scale.cells.keys, self._rows(scale.cells), self.reach, scale.points,
                scale.attributes, self.places, queries, scale.order, scale.starts, target, scale.radius, table,
                number * len(_COLUMNS),
            )  # fmt: skip
            run_in_chunks(describe, len(scale.cells), n_threads=n_threads)
        return table

    def _rows(self, cells: Cells) -> NDArray[np.int64]:
        """Return the columns of cells that a sphere can touch."""
        rows = cells.rows(self.reach)
        gaps = np.maximum(np.abs(rows[:, :2]) - 1, 0)
        return rows[(gaps**2).sum(axis=1) <= self.reach**2]


def find_spheres(
    xyz: ArrayLike,
    attributes: Mapping[str, ArrayLike],
    *,
    radius: float = 0.1,
    n_scales: int = 8,
    ratio: float = 2.0,
    points_per_radius: float = 5.0,
) -> SpherePyramid:
    """Subsample a cloud for each scale.

    A cell of the finest scale is represented by the mean of its points, one of a coarser scale by the mean of the
    voxels of the finest scale in it.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres, z up; at least one point.
    attributes : mapping of str to array-like of shape (n,)
        Values of some of `ATTRIBUTES`, in comparable units for all clouds.
    radius : float, default 0.1
        Radius of the finest scale, metres (thomas2018: 0.1).
    n_scales : int, default 8
        Number of scales (thomas2018: 8).
    ratio : float, default 2.0
        Ratio of the radii of successive scales (thomas2018: 2).
    points_per_radius : float, default 5.0
        Ratio of radius and cell (thomas2018: 5).

    Returns
    -------
    SpherePyramid
        The subsampled clouds.

    Raises
    ------
    DataError
        If there is no point, a coordinate is not finite, a column has another length or NaN, an attribute is unknown,
        or the extent is too large for the cells.
    ParameterError
        If a parameter is outside its domain.
    """
    check_spheres(radius, n_scales, ratio, points_per_radius)
    points = check_xyz(xyz, minimum=1)
    unknown = set(attributes) - set(ATTRIBUTES)
    if unknown:
        raise DataError(f"unknown attributes {sorted(unknown)}: known are {', '.join(ATTRIBUTES)}")
    present = [name for name in ATTRIBUTES if name in attributes]
    columns = [np.asarray(check_column(attributes[name], len(points), name), np.float64) for name in present]
    for name, column in zip(present, columns, strict=True):
        if np.isnan(column).any():
            raise DataError(f"{name} is NaN in row {int(np.argmax(np.isnan(column)))}")
    values = np.column_stack(columns) if columns else np.zeros((len(points), 0))
    cells, order, starts, minimum = find_voxels(points, radius / points_per_radius)
    owner = spread_owners(order, starts)
    centroids = kernels.average_groups(points - minimum, order, starts)
    values = kernels.average_groups(values, order, starts)
    own = np.arange(len(cells) + 1, dtype=np.int64)
    scales = [_Scale(cells, own[:-1].astype(np.int32), own, centroids, values, radius)]
    for number in range(1, n_scales):
        size = radius * ratio**number
        cells, order, starts, _ = find_voxels(centroids, size / points_per_radius)
        means = [kernels.average_groups(array, order, starts) for array in (centroids, values)]
        scales.append(_Scale(cells, order, starts, means[0], means[1], size))
    places = np.array([2 * ATTRIBUTES.index(name) for name in present], np.int64)
    return SpherePyramid(owner, tuple(scales), places, ceil(points_per_radius))


def check_spheres(radius: float, n_scales: int, ratio: float, points_per_radius: float, prefix: str = "") -> None:
    """Check the parameters of the neighbourhoods.

    Parameters
    ----------
    radius, n_scales, ratio, points_per_radius : float
        Parameters of `find_spheres`.
    prefix : str, default ""
        First characters of their names in messages.

    Raises
    ------
    ParameterError
        If one is outside its domain.
    """
    check_positive(radius, f"{prefix}radius")
    check_at_least(n_scales, 1, f"{prefix}n_scales")
    if not ratio > 1:
        raise ParameterError(f"{prefix}ratio must be above 1, got {ratio!r}")
    if not 1 <= points_per_radius <= MOST_PER_RADIUS:
        raise ParameterError(f"{prefix}points_per_radius must be in 1..{MOST_PER_RADIUS}, got {points_per_radius!r}")
