import numpy as np

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.stages import find_ground, inlier_rows


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
