import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.algorithms.stages import (
    build_supervoxels,
    describe_supervoxels,
    find_ground,
    inlier_rows,
    supervoxels_with_features,
)


def test_outliers_are_left_out_and_a_scene_without_any_is_not_copied(rng):
    xyz = rng.uniform([0, 0, 0], [20, 20, 0.05], (4000, 3))
    outlier = np.arange(4000) % 50 == 0
    scene, marked = PointCloud(xyz), PointCloud(xyz, {"outlier": outlier})
    assert np.shares_memory(scene.xyz[inlier_rows(scene)], xyz)
    np.testing.assert_array_equal(marked.xyz[inlier_rows(marked)], xyz[~outlier])
    unmarked = PointCloud(xyz, {"outlier": np.zeros(4000, dtype=bool)})
    plain, again = (find_ground(cloud, GroundParameters()) for cloud in (scene, unmarked))
    np.testing.assert_array_equal(plain["height"], again["height"])
    rest = find_ground(PointCloud(xyz[~outlier]), GroundParameters())
    own = find_ground(marked, GroundParameters())
    np.testing.assert_array_equal(own["height"][~outlier], rest["height"])
    assert np.isnan(own["height"][outlier]).all() and not own["ground"][outlier].any()


@pytest.mark.parametrize("ball_voxel_size", [0.2, 0.3])
def test_both_stages_of_supervoxels_are_those_of_one_call(rng, ball_voxel_size):
    outlier = np.arange(3000) % 60 == 0
    scene = PointCloud(rng.uniform([0, 0, 0], [6, 6, 2], (3000, 3)).astype(np.float32), {"outlier": outlier})
    ground = find_ground(scene, GroundParameters())
    selection = FeatureParameters(ball_voxel_size=ball_voxel_size)
    supervoxels, features = supervoxels_with_features(scene, ground, SupervoxelParameters(voxel_size=0.2), selection)
    alone = build_supervoxels(scene, SupervoxelParameters(voxel_size=0.2))
    np.testing.assert_array_equal(supervoxels["labels"], alone["labels"])
    np.testing.assert_array_equal(supervoxels["adjacency"].indices, alone["adjacency"].indices)
    expected = describe_supervoxels(scene, ground, alone, selection)
    for name in ("values", "names", "centroids", "counts"):
        np.testing.assert_array_equal(features[name], expected[name])
