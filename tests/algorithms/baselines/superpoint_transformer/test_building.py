"""Points of level 0 of dense scenes."""

import numpy as np

from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.building import points_of_superpoints


def test_many_superpoints_and_voxels_do_not_overflow():
    rng = np.random.default_rng(3)
    superpoint = rng.integers(0, 70_000, 5_000).astype(np.int32)  # as supervoxels are numbered
    voxel = rng.integers(0, 90_000, 5_000)
    owner, row = points_of_superpoints(superpoint, voxel)
    np.testing.assert_array_equal(owner[row], superpoint)
    assert len(owner) == len(set(zip(superpoint.tolist(), voxel.tolist(), strict=True)))
    assert (np.diff(owner) >= 0).all()
