"""Superpoints of the levels: shape, size, heights, neighbours and merging."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.geometry.neighbors import nearest_neighbors
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS, HierarchyParameters


@njit(cache=True, nogil=True)
def _best_partners(
    values: NDArray, weights: NDArray, edges: NDArray, lengths: NDArray, regularisation: float
) -> NDArray[np.int64]:
    """Return for each region the best edge that lowers the energy, -1 without one; ties go to the lower edge."""
    gain = np.zeros(len(weights))
    best = np.full(len(weights), -1, np.int64)
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        squared = 0.0
        for k in range(values.shape[1]):
            squared += (values[a, k] - values[b, k]) ** 2
        saved = regularisation * lengths[e] - weights[a] * weights[b] / (weights[a] + weights[b]) * squared
        if saved > gain[a]:
            gain[a], best[a] = saved, e
        if saved > gain[b]:
            gain[b], best[b] = saved, e
    return best


def merge_regions(
    values: NDArray[np.floating],
    weights: NDArray[np.floating],
    edges: NDArray[np.integer],
    *,
    regularisation: float,
) -> NDArray[np.int32]:
    """Merge adjacent regions with similar values.

    The energy is the sum of the weighted squared distances of the regions from the mean of their group, plus
    `regularisation` for each edge between groups.
    """
    owner: NDArray[np.integer] = np.arange(len(weights))
    means, mass = np.array(values, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    pairs: NDArray[np.int64] = np.array(edges, dtype=np.int64).reshape(-1, 2)
    lengths: NDArray[Any] = np.ones(len(pairs))
    while True:
        best = _best_partners(means, mass, pairs, lengths, regularisation)
        chosen = pairs[rank_integers(best[best >= 0])[0]]
        mutual = chosen[best[chosen[:, 0]] == best[chosen[:, 1]]]
        if not len(mutual):
            return owner.astype(np.int32)
        head = np.arange(len(mass))
        head[mutual.max(axis=1)] = mutual.min(axis=1)
        _, group = rank_integers(head)
        total = np.bincount(group, mass).astype(np.float64)
        means = np.stack([np.bincount(group, mass * column) for column in means.T], axis=1) / total[:, None]
        mass, owner = total, group[owner]
        pairs, lengths = _contract(group[pairs].astype(np.int64), lengths, len(mass))


def _contract(pairs: NDArray[np.int64], lengths: NDArray[Any], n: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Drop edges within a group and sum those between the same two groups."""
    between = pairs[:, 0] != pairs[:, 1]
    pairs = np.sort(pairs[between], axis=1)
    keys, row = rank_integers(pairs[:, 0] * n + pairs[:, 1])
    ends: NDArray[np.int64] = np.stack([keys // n, keys % n], axis=1)
    return ends, np.bincount(row, lengths[between], minlength=len(keys))


@njit(cache=True, nogil=True)
def _sum_columns(
    row: NDArray[np.int64], columns: NDArray[np.floating], n: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the sums and numbers of the finite values of each group and column."""
    sums = np.zeros((n, columns.shape[1]))
    counts = np.zeros((n, columns.shape[1]), np.int64)
    for i in range(len(row)):
        for k in range(columns.shape[1]):
            value = np.float64(columns[i, k])
            if np.isfinite(value):
                sums[row[i], k] += value
                counts[row[i], k] += 1
    return sums, counts


def means(row: NDArray[np.integer], columns: NDArray, n: int) -> NDArray[np.float64]:
    """Return the means of columns per group."""
    kind = np.float32 if columns.dtype == np.float32 else np.float64
    sums, counts = _sum_columns(row.astype(np.int64, copy=False), np.ascontiguousarray(columns, kind), n)
    with np.errstate(invalid="ignore"):
        return sums / counts


@njit(cache=True, nogil=True)
def sum_products(
    owner: NDArray[np.int64], places: NDArray[np.float64], centroid: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return sums of products of coordinates from the centroid, and the largest distance from it, per superpoint."""
    products, radius = np.zeros((len(centroid), 3, 3)), np.zeros(len(centroid))
    offset = np.empty(3)
    for i in range(len(owner)):
        o = owner[i]
        for a in range(3):
            offset[a] = places[i, a] - centroid[o, a]
            for b in range(a + 1):
                products[o, a, b] += offset[a] * offset[b]
        squared = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
        radius[o] = max(radius[o], squared)
    for o in range(len(radius)):
        radius[o] = np.sqrt(radius[o])
        for a in range(3):
            for b in range(a):
                products[o, b, a] = products[o, a, b]
    return products, radius


@njit(cache=True, nogil=True)
def extremes(
    owner: NDArray[np.int64], values: NDArray[np.float64], n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest finite value of each superpoint, NaN without one."""
    low, high = np.full(n, np.nan), np.full(n, np.nan)
    for i in range(len(owner)):
        o = owner[i]
        if np.isfinite(values[i]):
            if not low[o] <= values[i]:
                low[o] = values[i]
            if not high[o] >= values[i]:
                high[o] = values[i]
    return low, high


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
