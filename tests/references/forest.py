"""Slow, obvious versions of the neighbourhood, feature and forest kernels."""

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree


def radius_lists(xyz, radius, queries=None):
    """List the neighbours within a radius by SciPy's tree."""
    found = cKDTree(xyz).query_ball_point(xyz if queries is None else queries, radius)
    return [sorted(indices) for indices in found]


def eigen_features(points):
    """Describe one neighbourhood by numpy.linalg.eigh in float64; the normal and direction up to their sign."""
    points = np.asarray(points, dtype=np.float64)
    values, vectors = np.linalg.eigh(np.cov(points.T, bias=True))
    l3, l2, l1 = np.maximum(values, 0)
    e = np.array([l1, l2, l3]) / (l1 + l2 + l3)
    with np.errstate(divide="ignore", invalid="ignore"):
        entropy = -np.where(e > 0, e * np.log(e), 0).sum()
    normal, direction = vectors[:, 0], vectors[:, 2]
    return {
        "eigenvalue_1": l1,
        "eigenvalue_2": l2,
        "eigenvalue_3": l3,
        "linearity": (l1 - l2) / l1,
        "planarity": (l2 - l3) / l1,
        "scattering": l3 / l1,
        "omnivariance": np.cbrt(e.prod()),
        "anisotropy": (l1 - l3) / l1,
        "eigenentropy": entropy,
        "change_of_curvature": e[2],
        "verticality": 1 - abs(normal[2]),
        "normal": normal,
        "direction": direction,
        "neighbor_count": len(points),
    }


def voxel_partition(xyz, size):
    """Put every point in the supervoxel of its grid cell; cells that share a face, edge or corner are neighbours."""
    cells = np.floor((xyz - xyz.min(axis=0)) / size).astype(int)
    occupied, labels = np.unique(cells, axis=0, return_inverse=True)
    gaps = np.abs(occupied[:, None] - occupied[None]).max(axis=2)
    return labels.ravel().astype(np.int32), csr_array((gaps == 1).astype(np.int8))


def column_statistics(values, labels, n):
    """Mean, population standard deviation, minimum and maximum of the defined values of each supervoxel."""
    rows = []
    for s in range(n):
        own = values[labels == s]
        own = own[~np.isnan(own)].astype(np.float64)
        rows.append([own.mean(), own.std(), own.min(), own.max()] if len(own) else [np.nan] * 4)
    return np.array(rows)


def detrended(values, adjacency):
    """Equations 2 and 3 of Tomic et al. 2019, supervoxel by supervoxel."""
    dense = adjacency.toarray() != 0
    out = np.empty_like(values, dtype=np.float64)
    for s in range(len(values)):
        n = int(dense[s].sum())
        for f in range(values.shape[1]):
            around = values[dense[s], f].astype(np.float64)
            around = around[~np.isnan(around)]
            if n == 0:
                out[s, f] = 0 if not np.isnan(values[s, f]) else np.nan
            else:
                out[s, f] = n / (n + 1) * (values[s, f] - around.mean()) if len(around) else np.nan
    return out
