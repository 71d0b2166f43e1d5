"""Shape-based segmentation: classification by dimensionality, region growing and merging (Yang and Dong 2013).

Yu et al. 2016 compare their segmentation with it (section V-B). The article, "A shape-based segmentation method for
mobile laser scanning point clouds", was not available; docs/methods/segmentation.md lists the assumptions.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive, check_xyz
from mlsroad_pipeline.algorithms.features.eigen import compute_eigen_features
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.geometry.neighbors import radius_neighbors
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation.euclidean import number_objects

LINEAR, PLANAR, VOLUMETRIC = 0, 1, 2


@dataclass(frozen=True)
class YangDongParameters:
    """Parameters of the shape-based segmentation."""

    voxel_size: float = 0.1  # m, points are thinned to voxels of this edge
    radii: tuple[float, ...] = (0.2, 0.35, 0.5)  # m, of neighbourhoods; that of least entropy is used
    tolerance: float = 0.25  # m, distance within which voxels are neighbours
    max_angle: float = 20.0  # degrees between directions or normals of neighbours; smaller gives more segments
    min_voxels: int = 15  # smaller segments are merged with the segment that they touch most
    contact: float = 0.3  # share of the smaller of two segments that must touch the other for a merge, 0 to 1
    pole_height: float = 1.5  # m, upright lines from this height on are not merged with foliage beside them

    def __post_init__(self) -> None:
        object.__setattr__(self, "radii", tuple(float(radius) for radius in self.radii))
        if not self.radii:
            raise ParameterError("yang_dong.radii must name at least one radius")
        for name in ("voxel_size", "tolerance", "max_angle", "min_voxels", "pole_height"):
            check_positive(getattr(self, name), f"yang_dong.{name}")
        for radius in self.radii:
            check_positive(radius, "yang_dong.radii")
        if not 0 <= self.contact <= 1:
            raise ParameterError(f"yang_dong.contact must be between 0 and 1, got {self.contact!r}")


def segment_yang_dong(
    xyz: ArrayLike, *, parameters: YangDongParameters = YangDongParameters(), min_points: int = 1
) -> NDArray[np.int32]:
    """Segment off-ground points, m, into objects by the shape of neighbourhoods; -1 below `min_points`."""
    points = check_xyz(xyz).astype(np.float64, copy=False)
    if len(points) == 0:
        return number_objects(np.zeros(0, np.int64), min_points)
    grid = build_voxel_grid(points, voxel_size=parameters.voxel_size)
    places = grid.centroids
    kind, direction = classify_dimensions(places, parameters.radii)
    indices, indptr = radius_neighbors(places, radius=parameters.tolerance)
    here = np.repeat(np.arange(len(places)), np.diff(indptr))
    edges = np.column_stack([here, indices])[here < indices]
    cosine = np.abs((direction[edges[:, 0]] * direction[edges[:, 1]]).sum(axis=1))
    alike = (kind[edges[:, 0]] == kind[edges[:, 1]]) & (
        (kind[edges[:, 0]] == VOLUMETRIC) | (cosine >= np.cos(np.radians(parameters.max_angle)))
    )
    segments = connected_components(edges[alike], n_nodes=len(places))
    segments = _absorb_small(segments, edges, parameters.min_voxels)
    objects = _merge(segments, edges, kind, places, parameters)
    return number_objects(objects[grid.voxel_of_point].astype(np.int64), min_points)


def classify_dimensions(
    places: NDArray[np.float64], radii: tuple[float, ...]
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Return kind and direction of the neighbourhood of each place at the radius of least entropy.

    The direction is that of a line or the normal of a plane; zero for volumes and for fewer than three places.
    """
    least = np.full(len(places), np.inf)
    kind = np.full(len(places), VOLUMETRIC, np.int8)
    direction = np.zeros((len(places), 3))
    for radius in radii:
        eigen = compute_eigen_features(places, radius=radius)
        root = np.sqrt(np.stack([np.maximum(eigen[f"eigenvalue_{k}"], 0) for k in (1, 2, 3)]).astype(np.float64))
        with np.errstate(invalid="ignore", divide="ignore"):
            shape = np.stack([root[0] - root[1], root[1] - root[2], root[2]]) / root[0]
            entropy = -np.where(shape > 0, shape * np.log(shape), 0.0).sum(axis=0)
        axes = np.stack([eigen["direction_x"], eigen["direction_y"], eigen["direction_z"]], axis=1)
        normals = np.stack([eigen["nx"], eigen["ny"], eigen["nz"]], axis=1)
        better = np.isfinite(shape).all(axis=0) & (entropy < least)
        least[better] = entropy[better]
        kind[better] = shape[:, better].argmax(axis=0)
        direction[better] = np.where((kind[better] == LINEAR)[:, None], axes[better], normals[better])
    direction[kind == VOLUMETRIC] = 0.0
    return kind, np.nan_to_num(direction)


def _contacts(segments: NDArray[np.int32], edges: NDArray[np.int64]) -> tuple[NDArray, NDArray, NDArray, list[NDArray]]:
    """Return the ordered pairs of touching segments (a, b), and number and indices of the voxels of a that touch b."""
    both = np.concatenate([edges, edges[:, ::-1]])
    a, b = segments[both[:, 0]].astype(np.int64), segments[both[:, 1]].astype(np.int64)
    apart = a != b
    n = int(segments.max()) + 1
    touch = np.unique(np.column_stack([a[apart] * n + b[apart], both[apart, 0]]), axis=0)
    pairs, first, count = np.unique(touch[:, 0], return_index=True, return_counts=True)
    voxels = np.split(touch[:, 1], first[1:]) if len(pairs) else []
    return pairs // n, pairs % n, count, voxels


def _absorb_small(segments: NDArray[np.int32], edges: NDArray[np.int64], min_voxels: int) -> NDArray[np.int32]:
    """Merge small segments with the segment that they touch most; two rounds, as merged segments grow."""
    for _ in range(2):
        size = np.bincount(segments)
        a, b, count, _ = _contacts(segments, edges)
        # Largest contact first, then the larger neighbour.
        order = np.lexsort((b, -size[b], -count, a)) if len(a) else np.zeros(0, np.int64)
        best = order[np.unique(a[order], return_index=True)[1]] if len(a) else order
        small = best[(size[a[best]] < min_voxels) & ((size[b[best]] >= min_voxels) | (size[b[best]] >= size[a[best]]))]
        segments = connected_components(np.column_stack([a[small], b[small]]), n_nodes=len(size))[segments]
    return segments


def _merge(
    segments: NDArray[np.int32], edges: NDArray[np.int64], kind: NDArray[np.int8], places: NDArray[np.float64],
    parameters: YangDongParameters,
) -> NDArray[np.int32]:  # fmt: skip
    """Merge touching segments into objects, except upright poles with the foliage that they pass through."""
    n = int(segments.max()) + 1
    size = np.bincount(segments, minlength=n)
    table = np.zeros((n, 3), np.int64)
    np.add.at(table, (segments, kind), 1)
    main = table.argmax(axis=1)
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, segments, places)
    np.maximum.at(high, segments, places)
    extent = high - low
    pole = (main == LINEAR) & (extent[:, 2] >= parameters.pole_height) & (extent[:, 2] > 2 * extent[:, :2].max(axis=1))
    a, b, count, voxels = _contacts(segments, edges)
    smaller = (size[a] < size[b]) | ((size[a] == size[b]) & (a < b))
    good = smaller & (count >= parameters.contact * size[a])
    passing = np.array([_passes(places[v, 2], low[s, 2], high[s, 2]) for s, v in zip(a, voxels, strict=True)], bool)
    beside = pole[a] & (main[b] == VOLUMETRIC) & passing
    under = pole[a] & (main[b] == VOLUMETRIC) & ~passing  # a trunk and the crown on it
    return connected_components(np.column_stack([a, b])[(good & ~beside) | under], n_nodes=n)[segments]


def _passes(heights: NDArray[np.float64], low: float, high: float) -> bool:
    """Return whether contacts at these heights lie along a pole rather than at its upper end."""
    return bool(np.median(heights) < low + 0.75 * (high - low))
