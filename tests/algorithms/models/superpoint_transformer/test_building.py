"""Points of level 0 of dense scenes."""

import numpy as np

from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import points_of_superpoints


def test_many_superpoints_and_voxels_do_not_overflow():
    rng = np.random.default_rng(3)
    superpoint = rng.integers(0, 70_000, 5_000).astype(np.int32)  # as supervoxels are numbered
    voxel = rng.integers(0, 90_000, 5_000)
    owner, row = points_of_superpoints(superpoint, voxel)
    np.testing.assert_array_equal(owner[row], superpoint)
    assert len(owner) == len(set(zip(superpoint.tolist(), voxel.tolist(), strict=True)))
    assert (np.diff(owner) >= 0).all()


def test_points_of_whole_voxels_are_those_of_a_sort_of_all_points():
    rng = np.random.default_rng(4)
    voxel = np.append(np.arange(600), rng.integers(0, 600, 4_000))
    superpoint = (rng.integers(0, 70, 600) * 3)[voxel].astype(np.int32)
    for other in (superpoint, np.append(superpoint[:-1], 1).astype(np.int32)):  # the last voxel is shared by two
        owner, row = points_of_superpoints(other, voxel)
        pairs, expected = np.unique(np.stack([other, voxel], axis=1), axis=0, return_inverse=True)
        np.testing.assert_array_equal(owner, pairs[:, 0])
        np.testing.assert_array_equal(row, expected)
