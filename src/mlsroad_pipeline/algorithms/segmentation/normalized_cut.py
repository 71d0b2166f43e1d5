"""Extended voxel-based normalised cut of Euclidean clusters into objects (Yu et al. 2016, section IV-A).

With intensity this is the method of the paper; without, the cut that the paper compares with.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column, check_xyz
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation._bisection import (
    best_split,
    extend,
    gather,
    node_weights,
    second_eigenvector,
    smoothness,
)
from mlsroad_pipeline.algorithms.segmentation._nodes import measure_voxels, number_voxels, smooth_intensities
from mlsroad_pipeline.algorithms.segmentation.cut_parameters import NormalizedCutParameters
from mlsroad_pipeline.algorithms.segmentation.numbering import number_objects
from mlsroad_pipeline.algorithms.segmentation.plates import separate_plates
from mlsroad_pipeline.algorithms.segmentation.pole_parameters import POLE_REFINEMENT, PoleRefinementParameters
from mlsroad_pipeline.algorithms.segmentation.poles import separate_poles
from mlsroad_pipeline.algorithms.segmentation.rejoining import join_stacked_poles, rejoin_floating_parts
from mlsroad_pipeline.algorithms.segmentation.spacing import cluster_by_spacing

_DEFAULTS = NormalizedCutParameters()
_BINS = 12  # of the histogram of an eigenvector's values
_LEAST_EIGENVALUE = 1e-3  # below, the graph is disconnected and the extension undefined


def segment(
    xyz: ArrayLike,
    *,
    intensity: ArrayLike | None = None,
    parameters: NormalizedCutParameters = _DEFAULTS,
    min_points: int = 1,
    refinement: PoleRefinementParameters = POLE_REFINEMENT,
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
    refinement : PoleRefinementParameters
        Limits and weights of the separation of poles, gantries and plates, which is not in the paper.

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
    voxel = number_voxels(clusters, grid.voxel_of_point)
    places, of_voxel = measure_voxels(points - grid.origin, values, voxel, clusters)
    links = np.zeros((0, 2), dtype=np.int64)
    if parameters.pole_length > 0:
        of_voxel, links = separate_poles(
            places[:, :3], np.bincount(voxel), of_voxel, free_length=parameters.pole_length, refinement=refinement
        )
    order = np.argsort(of_voxel, kind="stable")
    starts = np.searchsorted(of_voxel[order], np.arange(int(of_voxel.max()) + 2))
    scale = 1.0 / np.square([parameters.sigma_h, parameters.sigma_v, parameters.sigma_i])
    smoothings = (parameters.smoothing, parameters.tall_smoothing) if intensity is not None else (0.0, 0.0)
    low, tall = (_compared(places, of_voxel, size) for size in smoothings)
    parts = _cut_clusters(
        low, tall, order, starts, scale, parameters.max_distance**2, parameters.voxel_size, parameters.max_cut,
        parameters.max_smoothness, parameters.min_voxels, parameters.max_nodes, parameters.low_height,
        np.array(parameters.low_sigma_h, np.float64) ** -2.0, np.array(parameters.low_max_cut, np.float64),
    )  # fmt: skip
    if parameters.foot_height > 0:
        parts = rejoin_floating_parts(
            places[:, :3], of_voxel, parts, foot_height=parameters.foot_height, reach=2.0 * parameters.voxel_size
        )
    parts = connected_components(parts[links], n_nodes=int(parts.max()) + 1)[parts].astype(np.int64)
    parts = join_stacked_poles(places[:, :3], parts, max_gap=parameters.pole_gap)
    if parameters.plate_gap > 0:  # without intensity there is no contrast, and only thin sheets are separated
        parts = separate_plates(
            places, np.bincount(voxel), parts, free_length=parameters.plate_gap, refinement=refinement
        )
    return number_objects(parts[voxel], min_points)


def cluster_points(xyz: ArrayLike, parameters: NormalizedCutParameters) -> NDArray[np.int32]:
    """Cluster points by distance, the step before the cuts.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates without the ground, metres.
    parameters : NormalizedCutParameters
        Clustering distances.

    Returns
    -------
    ndarray of int32, shape (n,)
        Clusters, numbered by their first points.
    """
    return cluster_by_spacing(
        xyz,
        tolerance=parameters.tolerance,
        spacing_factor=parameters.spacing_factor,
        max_tolerance=parameters.max_tolerance,
    )


def _compared(places: NDArray[np.float64], clusters: NDArray[np.int32], size: float) -> NDArray[np.float64]:
    """Return the places with smoothed intensities, which the weights of edges compare."""
    if size == 0:
        return places
    return np.column_stack([places[:, :3], smooth_intensities(places, clusters, size=size)])


def _checked_intensity(intensity: ArrayLike, n_points: int) -> NDArray[np.float64]:
    values = check_column(intensity, n_points, "intensity").astype(np.float64)
    wrong = ~((values >= 0) & (values <= 1))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"intensity at row {row} is {values[row]}: it must be normalised to [0, 1]")
    return values


@njit(cache=True, nogil=True)
def _cut_clusters(
    low_places: NDArray[np.float64],
    tall_places: NDArray[np.float64],
    order: NDArray[np.int64],
    starts: NDArray[np.int64],
    scale: NDArray[np.float64],
    max_squared: float,
    voxel_size: float,
    max_cut: float,
    max_smoothness: float,
    min_voxels: int,
    max_nodes: int,
    low_height: float,
    low_scales: NDArray[np.float64],
    low_max_cuts: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return the part of each voxel; the voxels of a part become consecutive in `order`.

    Groups no higher than `low_height` compare the intensities of `low_places`, others those of `tall_places`.
    """
    parts = np.empty(len(low_places), np.int64)
    closer = scale.copy()
    n_parts = 0
    for c in range(len(starts) - 1):
        stack = [(starts[c], starts[c + 1])]
        while len(stack) > 0:
            first, stop = stack.pop()
            members = order[first:stop].copy()
            low = len(members) > 0 and np.ptp(low_places[members, 2]) <= low_height
            places = low_places if low else tall_places
            side = _bisect(
                places, members, scale, max_squared, voxel_size, max_cut, max_smoothness, min_voxels, max_nodes
            )
            for k in range(len(low_scales)):
                if not low or low_height == 0 or side.any():
                    break
                closer[0] = low_scales[k]
                side = _bisect(
                    places, members, closer, max_squared, voxel_size, low_max_cuts[k], max_smoothness, min_voxels,
                    max_nodes,
                )  # fmt: skip
            n_left = np.int64(side.sum())
            if n_left == 0:
                parts[members] = n_parts
                n_parts += 1
                continue
            left, right = first, first + n_left
            for k in range(len(members)):
                if side[k]:
                    order[left] = members[k]
                    left += 1
                else:
                    order[right] = members[k]
                    right += 1
            stack.append((first, first + n_left))
            stack.append((first + n_left, stop))
    return parts


@njit(cache=True, nogil=True)
def _bisect(
    places: NDArray[np.float64],
    members: NDArray[np.int64],
    scale: NDArray[np.float64],
    max_squared: float,
    voxel_size: float,
    max_cut: float,
    max_smoothness: float,
    min_voxels: int,
    max_nodes: int,
) -> NDArray[np.bool_]:
    """Return which voxels are on one side of the best cut; none where the group remains whole."""
    whole = np.zeros(len(members), np.bool_)
    if len(members) < 2 * min_voxels:
        return whole
    values, threshold = _cut_values(
        places, members, scale, max_squared, voxel_size, max_cut, max_smoothness, min_voxels, max_nodes
    )
    side = values <= threshold
    n_left = side.sum()
    return side if min(n_left, len(members) - n_left) >= min_voxels else whole


@njit(cache=True, nogil=True)
def _cut_values(
    places: NDArray[np.float64],
    members: NDArray[np.int64],
    scale: NDArray[np.float64],
    max_squared: float,
    voxel_size: float,
    max_cut: float,
    max_smoothness: float,
    min_voxels: int,
    max_nodes: int,
) -> tuple[NDArray[np.float64], float]:
    """Return the eigenvector's value of each voxel and the value to cut at, NaN for no cut."""
    nodes, mass = gather(places, members, voxel_size, max_nodes)
    if len(nodes) < 2:
        return np.zeros(len(members)), np.nan
    weights = node_weights(nodes, mass, scale, max_squared)
    degree = weights.sum(axis=1)
    y, eigenvalue = second_eigenvector(weights, degree, nodes[:, 0] - nodes[:, 0].mean() + 0.7 * nodes[:, 1])
    if eigenvalue < _LEAST_EIGENVALUE or smoothness(y, mass, _BINS) > max_smoothness:
        return np.zeros(len(members)), np.nan
    threshold, cut = best_split(weights, degree, mass, y, float(min_voxels))
    if not cut <= max_cut:
        return np.zeros(len(members)), np.nan
    if len(nodes) == len(members):
        return y, threshold
    return extend(places, members, nodes, mass, y, eigenvalue, scale, max_squared), threshold
