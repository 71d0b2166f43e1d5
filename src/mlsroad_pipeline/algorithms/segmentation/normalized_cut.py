"""Extended voxel-based normalised cut of Euclidean clusters into objects (Yu et al. 2016, section IV-A).

With intensity this is the method of the paper; without, the cut that the paper compares with.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation.bisection import cut_clusters
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster_by_spacing, number_objects, number_pairs
from mlsroad_pipeline.algorithms.segmentation.plates import separate_plates
from mlsroad_pipeline.algorithms.segmentation.poles import join_stacked_poles, rejoin_floating_parts, separate_poles


@dataclass(frozen=True)
class NormalizedCutParameters:
    """Parameters of the clusters and of their normalised cuts; those of the paper are marked yu2016."""

    tolerance: float = 0.15  # m, clustering distance d_c (yu2016: 0.15); larger joins more into one cluster
    spacing_factor: float = 1.5  # clustering distance of sparse points, in units of their spacing (yu2016: 0)
    max_tolerance: float = 0.5  # m, upper limit of the clustering distance; up to `tolerance` disables the spacing
    voxel_size: float = 0.1  # m, w_s (yu2016: 0.1)
    sigma_h: float = 2.0  # m, horizontal distance over which a weight falls to 1/e (yu2016: 2); smaller cuts more
    sigma_v: float = 10.0  # m, the same vertically (yu2016: 10)
    sigma_i: float = 0.2  # the same for intensities in [0, 1] (yu2016: 1); smaller cuts between reflectivities
    smoothing: float = 0.2  # m, edges compare mean intensities over 3 x 3 x 3 cells of this edge (yu2016: 0, voxels)
    tall_smoothing: float = 2.0  # m, the same in groups above `low_height`, whose boughs vary in intensity
    max_distance: float = 5.0  # m, d_H, largest horizontal distance of an edge (yu2016: 5)
    max_cut: float = 0.45  # largest normalised cut that splits a group, 0 to 2
    min_voxels: int = 20  # fewest voxels of a part
    max_smoothness: float = 0.2  # largest ratio of smallest to largest bin of the eigenvector (Shi and Malik 2000)
    max_nodes: int = 256  # largest number of nodes of the graph; time grows with the square
    low_height: float = 3.0  # m, groups up to this height without a cut are cut again with the next two (yu2016: 0)
    low_sigma_h: Sequence[float] = (0.5, 1.0)  # m, in this order: cars and shrubs stand closer together than trees
    low_max_cut: Sequence[float] = (0.045, 0.14)  # one for each of `low_sigma_h`
    pole_length: float = 1.2  # m, least free length of a pole that is separated from its cluster (yu2016: 0, none)
    foot_height: float = 2.0  # m, parts that start higher above their cluster's foot are merged (yu2016: 0, none)
    pole_gap: float = 2.0  # m, largest gap across which narrow collinear upright parts are merged (yu2016: 0, none)
    plate_gap: float = 1.2  # m, least mast above a plate that is an object of its own (yu2016: 0, none)

    def __post_init__(self) -> None:
        for name in ("low_sigma_h", "low_max_cut"):
            object.__setattr__(self, name, tuple(np.atleast_1d(getattr(self, name)).tolist()))
        for name in (
            "tolerance", "max_tolerance", "voxel_size", "sigma_h", "sigma_v", "sigma_i", "max_distance", "min_voxels",
        ):  # fmt: skip
            check_positive(getattr(self, name), name)
        for name, value in (("max_cut", self.max_cut), *(("low_max_cut", value) for value in self.low_max_cut)):
            if not 0 <= value <= 2:
                raise ParameterError(f"{name} must be between 0 and 2, got {value!r}")
        for value in self.low_sigma_h:
            check_positive(value, "low_sigma_h")
        if len(self.low_sigma_h) != len(self.low_max_cut):
            raise ParameterError(
                f"low_sigma_h and low_max_cut must have the same number of values, got {len(self.low_sigma_h)} and "
                f"{len(self.low_max_cut)}"
            )
        for name in (
            "spacing_factor", "smoothing", "tall_smoothing", "max_smoothness", "low_height", "pole_length",
            "foot_height", "pole_gap", "plate_gap",
        ):  # fmt: skip
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"{name} must be at least 0, got {getattr(self, name)!r}")
        if self.max_nodes < 8:
            raise ParameterError(f"max_nodes must be at least 8, got {self.max_nodes!r}")


_DEFAULTS = NormalizedCutParameters()


def segment(
    xyz: ArrayLike,
    *,
    intensity: ArrayLike | None = None,
    parameters: NormalizedCutParameters = _DEFAULTS,
    min_points: int = 1,
) -> NDArray[np.int32]:
    """Segment off-ground points into objects.

    Points are clustered by distance. Each cluster's voxels form a graph whose edges are weighted by equation 19. The
    normalised cut (equation 20) of least value splits the graph in two, and its parts recursively. Recursion ends where
    a cut would cost more than `max_cut` or a part would be smaller than `min_voxels`.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates without the ground, metres.
    intensity : array-like of shape (n,), optional
        Normalised intensities in [0, 1]; without them the third factor of equation 19 is 1.
    parameters : NormalizedCutParameters
        Clustering distances, weights of edges, stopping rules and lengths that switch the refinement steps on.
    min_points : int, default 1
        Objects with fewer points are labelled -1.

    Returns
    -------
    ndarray of int32, shape (n,)
        Objects 0, 1, ... numbered by their first points; -1 below `min_points`.

    Raises
    ------
    DataError
        If `xyz` is not (n, 3) or not finite, or an intensity is not in [0, 1].
    ParameterError
        If `min_points` is below 1.
    """
    points = check_xyz(xyz)
    values = np.zeros(len(points)) if intensity is None else _checked_intensity(intensity, len(points))
    check_at_least(min_points, 1, "min_points")
    if len(points) == 0:
        return np.zeros(0, dtype=np.int32)
    clusters = cluster_points(points, parameters)
    grid = build_voxel_grid(points, voxel_size=parameters.voxel_size)
    voxel = number_pairs(grid.voxel_of_point, clusters)  # a voxel shared by two clusters has one number for each
    places, of_voxel = _measure_voxels(points - grid.origin, values, voxel, clusters)
    counts, links = np.bincount(voxel), np.zeros((0, 2), dtype=np.int64)
    if parameters.pole_length > 0:
        of_voxel, links = separate_poles(places[:, :3], counts, of_voxel, free_length=parameters.pole_length)
    order = np.argsort(of_voxel, kind="stable")
    starts = np.searchsorted(of_voxel[order], np.arange(int(of_voxel.max()) + 2))
    low_widths = parameters.low_sigma_h if parameters.low_height > 0 else ()
    widths = [(sigma_h, parameters.sigma_v, parameters.sigma_i) for sigma_h in (parameters.sigma_h, *low_widths)]
    smoothings = (parameters.smoothing, parameters.tall_smoothing) if intensity is not None else (0.0, 0.0)
    low, tall = (smooth_intensities(places, of_voxel, size=size) for size in smoothings)
    parts = cut_clusters(
        low, tall, order, starts, parameters.low_height, 1.0 / np.square(widths),
        np.array([parameters.max_cut, *parameters.low_max_cut], np.float64), parameters.max_distance**2,
        parameters.voxel_size, parameters.max_smoothness, parameters.min_voxels, parameters.max_nodes,
    )  # fmt: skip
    if parameters.foot_height > 0:
        reach = 2.0 * parameters.voxel_size
        parts = rejoin_floating_parts(places[:, :3], of_voxel, parts, foot_height=parameters.foot_height, reach=reach)
    parts = connected_components(parts[links], n_nodes=int(parts.max()) + 1)[parts].astype(np.int64)
    parts = join_stacked_poles(places[:, :3], parts, max_gap=parameters.pole_gap)
    if parameters.plate_gap > 0:  # without intensity there is no contrast, and only thin sheets are separated
        parts = separate_plates(places, counts, parts, free_length=parameters.plate_gap)
    return number_objects(parts[voxel], min_points)


def cluster_points(xyz: ArrayLike, parameters: NormalizedCutParameters) -> NDArray[np.int32]:
    """Cluster points by distance, the step before the cuts."""
    return cluster_by_spacing(
        xyz, tolerance=parameters.tolerance, spacing_factor=parameters.spacing_factor,
        max_tolerance=parameters.max_tolerance,
    )  # fmt: skip


def _checked_intensity(intensity: ArrayLike, n_points: int) -> NDArray[np.float64]:
    values = check_column(intensity, n_points, "intensity").astype(np.float64)
    wrong = ~((values >= 0) & (values <= 1))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"intensity at row {row} is {values[row]}: it must be normalised to [0, 1]")
    return values


def _measure_voxels(
    points: NDArray, values: NDArray[np.float64], voxel: NDArray[np.int64], clusters: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return centroid and interpolated intensity (equations 4, 8, 9) of each voxel, and its cluster."""
    count = np.bincount(voxel)
    low, high, of_voxel = np.full(len(count), np.inf), np.full(len(count), -np.inf), np.empty(len(count), np.int32)
    np.minimum.at(low, voxel, values)
    np.maximum.at(high, voxel, values)
    of_voxel[voxel] = clusters
    # Equation 9 is 0/0 for a constant intensity: all points then have the same weight, which gives the mean.
    spread = (high - low)[voxel]
    weight = np.divide(values - low[voxel], spread, out=np.ones(len(voxel)), where=spread > 0)
    middle = [np.bincount(voxel, points[:, axis]) / count for axis in range(3)]
    return np.column_stack([*middle, np.bincount(voxel, weight * values) / np.bincount(voxel, weight)]), of_voxel


def smooth_intensities(places: NDArray[np.float64], clusters: NDArray[np.int32], *, size: float) -> NDArray[np.float64]:
    """Return the places with the mean intensities of their cells and the 26 neighbours within the cluster."""
    if size == 0:
        return places
    cell = np.floor((places[:, :3] - places[:, :3].min(axis=0)) / size).astype(np.int64) + 1
    nx, ny, nz = (int(most) + 2 for most in cell.max(axis=0))  # an empty border keeps neighbours from wrapping
    names, of_cell = np.unique(
        ((clusters.astype(np.int64) * nx + cell[:, 0]) * ny + cell[:, 1]) * nz + cell[:, 2], return_inverse=True
    )
    own = np.bincount(of_cell, weights=places[:, 3]), np.bincount(of_cell).astype(np.float64)
    total, count = np.zeros(len(names)), np.zeros(len(names))
    for dx, dy, dz in np.ndindex(3, 3, 3):
        beside = names + ((dx - 1) * ny + dy - 1) * nz + dz - 1
        row = np.minimum(np.searchsorted(names, beside), len(names) - 1)
        there = names[row] == beside
        total += np.where(there, own[0][row], 0.0)
        count += np.where(there, own[1][row], 0.0)
    return np.column_stack([places[:, :3], (total / count)[of_cell]])
