"""Off-ground points to objects: Euclidean clusters, cut where they hold several (Yu et al. 2016, section IV-A).

With intensity this is the paper's extended voxel-based normalised cut; without, the one it is compared with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.graphs import connected_components
from mlsroad_pipeline.algorithms.segmentation._bisection import (
    best_split,
    extend,
    gather,
    node_weights,
    second_eigenvector,
    smoothness,
)
from mlsroad_pipeline.algorithms.segmentation._nodes import measure_voxels, number_voxels, smooth_intensities
from mlsroad_pipeline.algorithms.segmentation.numbering import number_objects
from mlsroad_pipeline.algorithms.segmentation.plates import separate_plates
from mlsroad_pipeline.algorithms.segmentation.poles import separate_poles
from mlsroad_pipeline.algorithms.segmentation.rejoining import join_stacked_poles, rejoin_floating_parts
from mlsroad_pipeline.algorithms.segmentation.spacing import cluster_by_spacing
from mlsroad_pipeline.algorithms.validation import check_at_least, check_column, check_positive, check_xyz
from mlsroad_pipeline.algorithms.voxels.grid import build_voxel_grid

_BINS = 12  # of the histogram of an eigenvector's values
_LEAST_EIGENVALUE = 1e-3  # below, nodes are no longer joined at all and the extension has no meaning


@dataclass(frozen=True)
class NormalizedCutParameters:
    """How points are grouped and groups are cut.

    Parameters
    ----------
    tolerance : float, default 0.15
        The clustering distance d_c of the paper, metres. Larger joins more into one cluster.
    spacing_factor : float, default 1.5
        Where points lie farther apart, the clustering distance is this times their spacing; 0 keeps to `tolerance`
        as the paper does. Larger joins sparse objects, and what stands close to them.
    max_tolerance : float, default 0.5
        The longest clustering distance that spacing leads to, metres; at `tolerance` and below spacing changes
        nothing.
    voxel_size : float, default 0.1
        The voxels' edge w_s, metres.
    sigma_h, sigma_v : float, default 2.0, 10.0
        Metres over which the weight of two voxels falls to 1/e, horizontally and vertically. A smaller `sigma_h` cuts
        objects that stand closer together, and wide ones in pieces.
    sigma_i : float, default 0.2
        The same for the intensity, in [0, 1] (yu2016: 1). Smaller separates by reflectivity more eagerly.
    smoothing : float, default 0.2
        Intensities that cuts compare are means over three times this in each direction, metres: single voxels of a
        crown differ more than a crown and a car do. 0 compares those of voxels, as the paper. Not in the paper.
    max_distance : float, default 5.0
        Voxels farther apart horizontally, d_H, have no edge, metres.
    max_cut : float, default 0.45
        A group is left whole where the least normalised cut is above this; 0 to 2. Larger cuts more. Not in the paper.
    min_voxels : int, default 20
        No part is made smaller than this. Not in the paper.
    max_smoothness : float, default 0.2
        A group is left whole where the values of its eigenvector are spread more evenly than this: the emptiest bin of
        their histogram over the fullest (Shi and Malik 2000). 1 never stops; smaller cuts less.
    max_nodes : int, default 256
        Size of the graph that a cut is found on; more follows the voxels more closely, and time grows with its square.
    low_height : float, default 3.0
        A group no higher than this that stays whole is tried again with each of `low_sigma_h` and `low_max_cut`,
        metres: cars and shrubs stand closer together than trees. Larger cuts more; 0 tries none, as the paper.
    low_sigma_h, low_max_cut : sequence of float, default (0.5, 1.0), (0.045, 0.14)
        In place of `sigma_h` and `max_cut` then, in this order, until a cut is found: what hangs together by little
        shows best at the smallest scale, where a cut of it costs next to nothing. Not in the paper.
    pole_length : float, default 1.2
        Poles that stand free over this length, below a crown or above a shrub, are taken out of their clusters before
        these are cut, metres; see `separate_poles`. Larger takes out fewer; 0 takes out none, as the paper.
    foot_height : float, default 2.0
        A part that does not come down to within this height above the foot of its cluster is joined again with the
        part that it touches most, metres: half a crown is no object. Larger joins fewer; 0 joins none, as the paper.
    pole_gap : float, default 2.0
        Narrow upright parts that lie in one line are joined over a gap of at most this, metres: something hides a
        stretch of a pole. Larger joins more; 0 joins none, as the paper.
    plate_gap : float, default 1.2
        Plates brighter than the mast that they hang on are objects of their own where the mast goes on for this length
        above them, metres; only with intensities, see `separate_plates`. Larger takes off fewer; 0 takes off none, as
        the paper.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    tolerance: float = 0.15
    spacing_factor: float = 1.5
    max_tolerance: float = 0.5
    voxel_size: float = 0.1
    sigma_h: float = 2.0
    sigma_v: float = 10.0
    sigma_i: float = 0.2
    smoothing: float = 0.2
    max_distance: float = 5.0
    max_cut: float = 0.45
    min_voxels: int = 20
    max_smoothness: float = 0.2
    max_nodes: int = 256
    low_height: float = 3.0
    low_sigma_h: Sequence[float] = (0.5, 1.0)
    low_max_cut: Sequence[float] = (0.045, 0.14)
    pole_length: float = 1.2
    foot_height: float = 2.0
    pole_gap: float = 2.0
    plate_gap: float = 1.2

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
                f"low_sigma_h and low_max_cut go together: {len(self.low_sigma_h)} and {len(self.low_max_cut)} values"
            )
        for name in (
            "spacing_factor", "smoothing", "max_smoothness", "low_height", "pole_length", "foot_height", "pole_gap",
            "plate_gap",
        ):  # fmt: skip
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"{name} must be at least 0, got {getattr(self, name)!r}")
        if self.max_nodes < 8:
            raise ParameterError(f"max_nodes must be at least 8, got {self.max_nodes!r}")


def segment(
    xyz: ArrayLike,
    *,
    intensity: ArrayLike | None = None,
    parameters: NormalizedCutParameters = NormalizedCutParameters(),
    min_points: int = 1,
) -> NDArray[np.int32]:
    """Segment off-ground points into objects.

    Points are clustered by distance. Each cluster's voxels form a graph whose edges are weighted by equation 19; the
    normalised cut (equation 20) of least value splits it in two, and so on with the parts, until a cut would cost more
    than `max_cut` or a part would be smaller than `min_voxels`.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates without the ground, metres.
    intensity : array-like of shape (n,), optional
        Normalised intensities in [0, 1]; without them the third factor of equation 19 is 1.
    parameters : NormalizedCutParameters
        See there.
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
    voxel = number_voxels(clusters, grid.voxel_of_point)
    places, of_voxel = measure_voxels(points - grid.origin, values, voxel, clusters)
    links = np.zeros((0, 2), dtype=np.int64)
    if parameters.pole_length > 0:
        of_voxel, links = separate_poles(
            places[:, :3], np.bincount(voxel), of_voxel, free_length=parameters.pole_length
        )
    order = np.argsort(of_voxel, kind="stable")
    starts = np.searchsorted(of_voxel[order], np.arange(int(of_voxel.max()) + 2))
    scale = 1.0 / np.square([parameters.sigma_h, parameters.sigma_v, parameters.sigma_i])
    compared = places.copy()
    if parameters.smoothing > 0 and intensity is not None:
        compared[:, 3] = smooth_intensities(places, of_voxel, size=parameters.smoothing)
    parts = _cut_clusters(
        compared, order, starts, scale, parameters.max_distance**2, parameters.voxel_size, parameters.max_cut,
        parameters.max_smoothness, parameters.min_voxels, parameters.max_nodes, parameters.low_height,
        np.array(parameters.low_sigma_h, np.float64) ** -2.0, np.array(parameters.low_max_cut, np.float64),
    )  # fmt: skip
    if parameters.foot_height > 0:
        parts = rejoin_floating_parts(
            places[:, :3], of_voxel, parts, foot_height=parameters.foot_height, reach=2.0 * parameters.voxel_size
        )
    parts = connected_components(parts[links], n_nodes=int(parts.max()) + 1)[parts].astype(np.int64)
    parts = join_stacked_poles(places[:, :3], parts, max_gap=parameters.pole_gap)
    if parameters.plate_gap > 0 and intensity is not None:
        parts = separate_plates(places, np.bincount(voxel), parts, free_length=parameters.plate_gap)
    return number_objects(parts[voxel], min_points)


def cluster_points(xyz: ArrayLike, parameters: NormalizedCutParameters) -> NDArray[np.int32]:
    """Cluster points as is done before they are cut.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates without the ground, metres.
    parameters : NormalizedCutParameters
        Distances.

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


def _checked_intensity(intensity: ArrayLike, n_points: int) -> NDArray[np.float64]:
    values = check_column(intensity, n_points, "intensity").astype(np.float64)
    wrong = ~((values >= 0) & (values <= 1))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(f"intensity at row {row} is {values[row]}: it must be normalised to [0, 1]")
    return values


@njit(cache=True, nogil=True)
def _cut_clusters(
    places: NDArray[np.float64],
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
    """Return the part of each voxel; the voxels of a part become consecutive in `order`."""
    parts = np.empty(len(places), np.int64)
    closer = scale.copy()
    n_parts = 0
    for c in range(len(starts) - 1):
        stack = [(starts[c], starts[c + 1])]
        while len(stack) > 0:
            first, stop = stack.pop()
            members = order[first:stop].copy()
            side = _bisect(
                places, members, scale, max_squared, voxel_size, max_cut, max_smoothness, min_voxels, max_nodes
            )
            low = len(members) >= 2 * min_voxels and low_height > 0 and np.ptp(places[members, 2]) <= low_height
            for k in range(len(low_scales)):
                if not low or side.any():
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
    """Tell which voxels are on one side of the best cut; none where the group stays whole."""
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
    """Return the eigenvector's value of each voxel and the value to cut at, NaN where there is no cut to make."""
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
