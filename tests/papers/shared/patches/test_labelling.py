"""Stations of training patches: along the trajectory, along the main axis of the survey, or along that of the scene."""

import numpy as np
import pytest
from references.patches import SCHEME, prepare

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scenes.corridor import MainAxis, corridor_to_arrays
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import cut_scenes
from mlsroad_pipeline.papers.shared.patches.labelling import label_patches_along
from mlsroad_pipeline.papers.shared.patches.training import join_training_scenes

ORIGIN = np.array([389_300.0, 5_819_700.0, 34.0])
TRACK = Trajectory.from_positions([[389_290.0, 5_819_721.0, 36.0], [389_330.0, 5_819_721.0, 36.0]])
AXIS = MainAxis(ORIGIN[:2] + [10.0, 21.0], np.array([1.0, 0.0]))


@pytest.mark.parametrize(("line", "first"), [(TRACK, 10.0), (AXIS, -10.0), (None, None)])
def test_a_scene_wider_than_long_is_cut_along_the_road(line, first):
    rng = np.random.default_rng(3)
    xyz = rng.random((6000, 3)) * [20.0, 42.0, 0.02]  # 20 m along the road, 42 m across
    road = PointCloud(xyz, {"label": np.full(6000, TAXONOMY["road"], np.uint8)}, ORIGIN)
    patches = prepare(road)
    labels = label_patches_along(road, patches, corridor_to_arrays(line), scheme=SCHEME)
    joined, _ = join_training_scenes({"train.a": patches}, {"train.a": labels})
    cut = cut_scenes(joined, 10.0)
    along, across = (
        np.array([np.ptp(joined.centroid[cut.scene == scene, axis]) for scene in range(cut.scene.max() + 1)])
        for axis in (0, 1)
    )
    if line is None:  # nothing tells where the road leads
        assert len(along) == 4 and (along > 19).all()
    else:
        np.testing.assert_allclose(labels["station"], patches["centroid"][:, 0] + first, atol=1e-4)
        assert len(along) == 2 and (along < 10.1).all() and (across > 41).all()
