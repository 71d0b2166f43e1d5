"""Detrending of supervoxel features by their local tendency (Tomic et al. 2019, equations 2 and 3)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array


@njit(cache=True, nogil=True, error_model="numpy")
def _neighbor_means(values: NDArray, indices: NDArray, indptr: NDArray) -> NDArray[np.float32]:
    n, width = values.shape
    means = np.full((n, width), np.nan, np.float32)
    total = np.zeros(width)
    defined = np.zeros(width)
    for s in range(n):
        total[:] = 0.0
        defined[:] = 0.0
        for j in range(indptr[s], indptr[s + 1]):
            row = values[indices[j]]
            for f in range(width):
                known = not np.isnan(row[f])
                total[f] += row[f] if known else 0.0
                defined[f] += 1.0 if known else 0.0
        for f in range(width):
            means[s, f] = total[f] / defined[f]
    return means


def local_tendency(values: NDArray[np.float32], adjacency: csr_array) -> NDArray[np.float32]:
    """Return the mean features V_LT of the first-order neighbours of each supervoxel, itself excluded."""
    return _neighbor_means(values, adjacency.indices, adjacency.indptr)


def detrend(values: NDArray[np.float32], adjacency: csr_array) -> NDArray[np.float32]:
    """Return the detrended features k (V_S - V_LT) with k = n / (n + 1) for n neighbours."""
    n = np.diff(adjacency.indptr).astype(np.float32)[:, None]
    alone = (n == 0) & ~np.isnan(values)
    weighted = n / (n + 1) * (values - local_tendency(values, adjacency))
    return np.where(alone, np.float32(0.0), weighted.astype(np.float32))
