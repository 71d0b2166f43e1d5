"""Labellers of any method that learn from answers: what changes, what stays, and what is refused."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.boosted_trees import answer_boosting, corrected
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import (
    Answer,
    ContinuationSettings,
    Replay,
    Scored,
)
from mlsroad_pipeline.algorithms.models.boosted_trees.corrected import (
    FLOOR,
    MOST,
    SLUG,
    added_trees,
    label_cloud_softly,
    labeller_of,
    learn_corrections,
    voxel_scores,
)
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import describe_scene
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels, context_of
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.model_store.shipped_models import load_shipped

SIZE = 0.2


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(answer_boosting, "SETTINGS", ContinuationSettings(rounds=30, min_child_samples=5))


def all_wall(cloud, bundle):
    """A labeller without probabilities that calls everything above 0.5 m a wall, and does not label the last point."""
    label = (cloud.xyz[:, 2] > 0.5).astype(np.int16)
    label[-1] = -1
    return label, np.full(len(cloud), 0.8, np.float32)


def softly(bundle, cloud):
    """The same with a row of probabilities per point."""
    label, confidence = all_wall(cloud, bundle)
    table = np.full((len(cloud), 3), 0.1, np.float32)
    table[np.arange(len(cloud)), np.maximum(label, 0)] = 0.8
    owner = np.where(label >= 0, np.arange(len(cloud)), -1)
    return SoftLabels(label, confidence, table, owner)


@pytest.fixture(params=["hard", "soft"])
def labeller(request, monkeypatch):
    given = {"hard": lambda bundle, cloud: SoftLabels(*all_wall(cloud, bundle)), "soft": softly}[request.param]
    monkeypatch.setattr(corrected, "label_softly", given)
    return ModelBundle("mine", {"own": np.arange(3)}, {"classes": ["ground", "wall", "pole"]})


@pytest.fixture(scope="module")
def scene():
    """Ground, a wall of 4 m, and eight poles of 4 m."""
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(0, 24, (9000, 2)), np.zeros(9000)])
    wall = np.column_stack([rng.uniform(0, 24, 6000), np.full(6000, 22.0), rng.uniform(0.05, 4, 6000)])
    poles = [
        np.column_stack([rng.normal((3 + 5 * (k % 4), 4 + 7 * (k // 4)), 0.04, (500, 2)), rng.uniform(0.05, 4, 500)])
        for k in range(8)
    ]
    truth = np.repeat([0, 1, 2], [9000, 6000, 4000])
    return PointCloud(np.concatenate([ground, wall, *poles]).astype(np.float32)), truth


def learned(labeller, scene, *, n_poles=4):
    cloud, truth = scene
    features = describe_scene(cloud, find_ground(cloud, GroundParameters()), voxel_size=SIZE)
    scores = voxel_scores(labeller, cloud, features.owner, len(features.values))
    of_pole = np.full(len(features.values), -1)
    of_pole[features.owner[truth == 2]] = (np.arange(len(truth))[truth == 2] - 15000) // 500
    high = features.values[:, 0] > 0.6
    answers = [
        Answer(features.values[rows], np.array([False, False, True]), scores[rows])
        for rows in (np.flatnonzero((of_pole == k) & high) for k in range(n_poles))
    ]
    rest = of_pole < 0
    of_wall = np.flatnonzero(rest & high)[:400]
    answers += [
        Answer(features.values[rows], np.array([False, True, False]), scores[rows]) for rows in np.split(of_wall, 4)
    ]
    none = np.zeros((0, features.values.shape[1]), np.float32)
    replay = Replay(none, np.zeros((0, 3), bool)), Scored(none, np.zeros((0, 3)))
    survey = Scored(features.values[rest], scores[rest])
    trees = BoostedTrees.from_arrays(load_shipped("general").arrays)
    return learn_corrections(labeller, answers, survey, replay, trees=trees, voxel_size=SIZE)


def test_an_answer_about_poles_changes_the_other_poles_and_keeps_the_rest(labeller, scene, tmp_path):
    cloud, truth = scene
    model = learned(labeller, scene)
    save_bundle(model, tmp_path / "model")
    read = load_bundle(tmp_path / "model")
    label, confidence = label_cloud_softly(cloud, read)[:2]
    np.testing.assert_array_equal(label, label_cloud_softly(cloud, model)[0])
    assert label[-1] == -1 and confidence[-1] == 0  # its labeller does not label it
    unseen = slice(15000 + 4 * 500, len(truth) - 1)
    high = cloud.xyz[:, 2] > 0.6
    assert (all_wall(cloud, None)[0][unseen][high[unseen]] == 1).all()
    assert (label[unseen][high[unseen]] == 2).mean() > 0.9
    assert (label[:9000] == 0).mean() > 0.99
    assert (label[9000:15000][high[9000:15000]] == 1).mean() > 0.95


def test_the_labeller_stays_and_a_second_learning_adds_trees(labeller, scene):
    once = learned(labeller, scene)
    twice = learned(once, scene)
    assert (once.slug, twice.slug, labeller_of(twice).slug) == (SLUG, SLUG, "mine")
    np.testing.assert_array_equal(labeller_of(twice).arrays["own"], np.arange(3))
    assert len(added_trees(twice)) == 2 * len(added_trees(once)) and added_trees(labeller) is None
    assert [entry["answers"] for entry in twice.metadata["learned"]] == [8, 8]
    soft = label_cloud_softly(scene[0], once)
    np.testing.assert_allclose(soft.probabilities.sum(axis=1), 1, rtol=1e-5)
    rows = soft.owner >= 0
    np.testing.assert_array_equal(soft.probabilities[soft.owner[rows]].argmax(axis=1), soft.labels[rows])


def test_trees_without_leaves_leave_the_labels_as_they_are(labeller, scene):
    model = learned(labeller, scene)
    arrays = {**model.arrays, "added/leaf": np.zeros_like(model.arrays["added/leaf"])}
    label = label_cloud_softly(scene[0], ModelBundle(SLUG, arrays, model.metadata))[0]
    np.testing.assert_array_equal(label, all_wall(scene[0], None)[0])


def test_scores_of_voxels_are_means_of_probabilities(labeller):
    cloud = PointCloud(np.array([[0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 2]], np.float32))
    found = voxel_scores(labeller, cloud, np.array([0, 0, 1, 2]), 4)
    own = 0.8
    other = (1 - own) / 2
    expected = [[(own + other) / 2, (own + other) / 2, other], [other, own, other], [1 / 3] * 3, [1 / 3] * 3]
    np.testing.assert_allclose(found, np.log(np.maximum(expected, FLOOR)), rtol=1e-5)  # the last point has no label
    assert own < MOST


def test_what_a_model_needs_is_checked(labeller, scene):
    model = learned(labeller, scene)
    damaged = ModelBundle(SLUG, model.arrays, {**model.metadata, "members": {}})
    with pytest.raises(DataError, match="its labeller is missing"):
        label_cloud_softly(scene[0], damaged)
    old = ModelBundle(SLUG, model.arrays, {**model.metadata, "feature_names": ["x"]})
    with pytest.raises(DataError, match="other features than this version"):
        label_cloud_softly(scene[0], old)
    other = ModelBundle(SLUG, model.arrays, {**model.metadata, "voxel_size": 0.5})
    with pytest.raises(DataError, match=r"voxels of 0\.5 m, not 0\.2 m"):
        learned(other, scene)


def test_the_context_is_that_of_the_labeller(labeller, scene):
    model = learned(labeller, scene)
    assert context_of(model) == 0
    member = {"base": {**model.metadata["members"]["base"], "slug": "superpoint_transformer"}}
    assert context_of(ModelBundle(SLUG, model.arrays, {**model.metadata, "members": member})) == 15
