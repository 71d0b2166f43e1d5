"""Voxels of objects: keys and runs against NumPy."""

import numpy as np

from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import runs_of_keys, voxel_keys, voxel_order


def test_voxels_of_points_are_those_of_floor(rng):
    local, origin = rng.normal(0.0, 2.0, (3000, 3)), np.array([583_000.3, -4_477_000.7, 12.0])
    key = voxel_keys(local, origin, 0.3)
    np.testing.assert_array_equal(key, np.floor((local + origin) / 0.3).astype(np.int64))
    order = voxel_order(key)
    np.testing.assert_array_equal(order, np.lexsort(key.T[::-1]))
    starts, voxel = runs_of_keys(key, order)
    distinct, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(voxel, inverse.ravel())
    np.testing.assert_array_equal(order[starts], first)
    assert len(starts) == len(distinct) < len(key)


def test_voxels_far_apart_are_sorted_without_a_packed_key(rng):
    key = rng.integers(-(2**40), 2**40, (50, 3))
    np.testing.assert_array_equal(voxel_order(key), np.lexsort(key.T[::-1]))
