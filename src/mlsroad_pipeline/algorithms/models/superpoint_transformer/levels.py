"""Superpoints of the levels: shape, size, heights, neighbours and merging."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.geometry.neighbors import nearest_neighbors
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers
from mlsroad_pipeline.algorithms.models.superpoint_transformer.merging import merge_regions
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS, HierarchyParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.superpoint_sums import extremes, means, sum_products

OWN_FEATURES = (
    "linearity", "planarity", "scattering", "verticality", "direction_z",
    "height_mean", "height_min", "height_max",
    "log_length", "log_surface", "log_volume", "log_size",
)  # fmt: skip
"""Features of superpoints from their points, on all levels."""

_MERGED = ("linearity", "planarity", "scattering", "verticality")
_HEIGHT_SCALE = 10.0
"""Height in metres that counts as much as a shape feature in the merging."""

_FLOOR = 1e-3
"""Smallest standard deviation of points along an axis, metres, for logarithms of sizes."""


def build_levels(
    places: NDArray[np.float64],
    height: NDArray[np.float64],
    owner: NDArray[np.int64],
    n: int,
    adjacency: csr_array,
    parameters: HierarchyParameters,
) -> tuple[list[dict[str, NDArray]], list[NDArray[np.int32]]]:
    """Describe the superpoints of all levels and merge those of a level into the next."""
    levels, parents = [_describe_level(places, height, owner, n)], []
    touching = np.stack(adjacency.nonzero(), axis=1).astype(np.int64)
    for i in range(N_LEVELS):
        level = levels[i]
        pairs = _neighbours(touching, level["centroid"], parameters.n_neighbors[i])
        level["indptr"], level["indices"] = _rows(pairs, len(level["centroid"]))
        if i + 1 == N_LEVELS:
            break
        merged = [OWN_FEATURES.index(name) for name in _MERGED]
        raised = np.nan_to_num(level["values"][:, [OWN_FEATURES.index("height_mean")]]) / _HEIGHT_SCALE
        place = level["centroid"] * parameters.spatial_weight[i]
        parent = merge_regions(
            np.hstack([np.nan_to_num(level["values"][:, merged]), raised, place]),
            np.ones(len(place)),
            pairs[pairs[:, 0] < pairs[:, 1]],
            regularisation=parameters.regularisation[i],
        )
        parents.append(parent)
        owner = parent[owner].astype(np.int64)
        touching = parent[touching].astype(np.int64)
        levels.append(_describe_level(places, height, owner, int(parent.max(initial=-1)) + 1))
    return levels, parents


def _describe_level(
    places: NDArray[np.float64], height: NDArray[np.float64], owner: NDArray[np.int64], n: int
) -> dict[str, NDArray]:
    """Return centroid, normal, size, radius and `OWN_FEATURES` of the superpoints of a level."""
    counts = np.bincount(owner, minlength=n)
    centroid = means(owner, places, n)
    products, radius = sum_products(owner, places, centroid)
    variances, axes = np.linalg.eigh(products / counts[:, None, None])
    deviations = np.sqrt(np.maximum(variances, 0.0))[:, ::-1]
    flat = counts >= 3
    first, second, third = np.maximum(deviations, _FLOOR).T
    size = np.log(np.stack([first, first * second, first * second * third, counts], axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        d1, d2, d3 = deviations.T
        shape = np.stack([(d1 - d2) / d1, (d2 - d3) / d1, d3 / d1, 1 - np.abs(axes[:, 2, 0]), np.abs(axes[:, 2, 2])], 1)
    shape[~flat | ~(deviations[:, 0] > _FLOOR)] = np.nan
    heights = np.stack([means(owner, height[:, None], n)[:, 0], *extremes(owner, height, n)], axis=1)
    normal = np.where(flat[:, None], axes[:, :, 0] * np.where(axes[:, 2, :1] < 0, -1.0, 1.0), 0.0)
    return {
        "centroid": centroid, "normal": normal, "size": size, "radius": radius,
        "values": np.hstack([shape, heights, size]),
    }  # fmt: skip


def _neighbours(touching: NDArray[np.int64], centroid: NDArray[np.float64], k: int) -> NDArray[np.int64]:
    """Return the pairs (target, source) of touching superpoints and nearest centroids, both ways, with loops."""
    n = len(centroid)
    nearest, indptr = nearest_neighbors(centroid, k=k + 1)
    near = np.stack([np.repeat(np.arange(n), np.diff(indptr)), nearest], axis=1).astype(np.int64)
    pairs = np.concatenate([touching, near, near[:, ::-1], np.repeat(np.arange(n), 2).reshape(-1, 2)])
    keys, _ = rank_integers(pairs[:, 0] * max(n, 1) + pairs[:, 1])
    return np.stack([keys // max(n, 1), keys % max(n, 1)], axis=1)


def _rows(pairs: NDArray[np.int64], n: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    return np.append(0, np.cumsum(np.bincount(pairs[:, 0], minlength=n))), pairs[:, 1].astype(np.int32)
