"""Mean distances to the nearest points, beside SciPy's tree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.spacing import mean_spacing


def expected(xyz, k):
    return cKDTree(xyz).query(xyz, k=k)[0].reshape(len(xyz), k).mean(axis=1)


@pytest.mark.parametrize(("n", "k"), [(1, 1), (2, 2), (7, 3), (50, 50), (700, 20), (5000, 8)])
def test_equals_scipy(rng, n, k):
    street = rng.random((n, 3)) * [100, 10, 0.01]
    lattice = np.round(rng.random((n, 3)) * 5) / 5  # duplicates and equal distances
    clusters = rng.normal(0, 0.01, (n, 3)) + 50 * rng.integers(0, 3, (n, 1))
    far = np.concatenate([street, [[1e4, 0, 0]]])
    for xyz in (street, lattice, clusters, far, np.zeros((n, 3))):
        np.testing.assert_allclose(mean_spacing(xyz, k=k), expected(xyz, k), rtol=1e-9, atol=1e-12)


def test_threads_give_the_same_bytes(rng):
    xyz = rng.random((3000, 3)) * [30, 30, 0.1]
    np.testing.assert_array_equal(mean_spacing(xyz, k=12), mean_spacing(xyz, k=12, n_threads=3))
