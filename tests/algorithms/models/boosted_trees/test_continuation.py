"""Boosting from answers: what is learned, what is kept, and the segments that a user is asked about."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.boosted_trees import answer_boosting
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Answer, ContinuationSettings, Replay
from mlsroad_pipeline.algorithms.models.boosted_trees.corrected import continue_training
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import softmax
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.segments import find_segments, order_of_questions
from mlsroad_pipeline.algorithms.models.boosted_trees.training import train_trees
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.model_store.object_classifiers import read_replay
from mlsroad_pipeline.model_store.shipped_models import load_shipped


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(answer_boosting, "SETTINGS", ContinuationSettings(rounds=60, bags=2, min_child_samples=5))


@pytest.fixture(scope="module")
def rows():
    values = np.random.default_rng(0).normal(size=(3000, 4)).astype(np.float32)
    values[::10, 3] = np.nan
    target = np.where(values[:, 2] > 1.5, 2, values[:, 0] + 0.3 * values[:, 1] > 0).astype(int)
    return values, np.eye(3, dtype=bool)[target]


@pytest.fixture(scope="module", params=[1.0, 2.5])
def bundle(rows, request):
    """A model of three classes, with a temperature."""
    own = BoostedTreesParameters(rounds=20, checkpoint_rounds=20, leaves=8, min_child_samples=5, feature_fraction=1.0)
    trees = train_trees(*rows, np.ones(len(rows[0])), parameters=own)
    scale = {"temperature": np.array(request.param), "offsets": np.zeros(3)}
    return ModelBundle("boosted_trees", {**trees.to_arrays(), **scale}, {"classes": ["a", "b", "c"]})


def answers(values):
    """Objects of the class c among what the model calls b, and objects of a and b that are right."""
    wrong = (values[:, 0] > 0.2) & (values[:, 1] > 1) & (values[:, 2] < 1)
    right = [Answer(values[~wrong & (values[:, 0] < 0) & (values[:, 2] < 1)][:60], np.array([True, False, False]))]
    right += [Answer(values[~wrong & (values[:, 0] > 0.3) & (values[:, 2] < 1)][:60], np.array([False, True, False]))]
    return wrong, [Answer(part, np.array([False, False, True])) for part in np.split(values[wrong][:80], 8)] + right


def labels(bundle, values):
    scores = BoostedTrees.from_arrays(bundle.arrays).scores(values) / bundle.arrays["temperature"]
    return softmax(scores + bundle.arrays["offsets"]).argmax(axis=1)


def test_an_answer_is_learned_and_the_rest_is_kept(bundle, rows):
    values, allowed = rows
    wrong, given = answers(values)
    replay = Replay(values[~wrong], allowed[~wrong])
    model = continue_training(bundle, given, values[~wrong], replay, learned_from={"x": 1})
    before, after = labels(bundle, values), labels(model, values)
    assert (before[wrong] == 1).mean() > 0.95 and (after[wrong] == 2).mean() > 0.8
    assert (after[~wrong] == before[~wrong]).mean() > 0.9
    assert [(entry["answers"], entry["x"]) for entry in model.metadata["learned"]] == [(10, 1)]
    assert "learned" not in bundle.metadata


def test_added_trees_use_the_thresholds_of_the_model_and_are_the_same_each_time(bundle, rows):
    values, allowed = rows
    wrong, given = answers(values)
    more = [*given, Answer(values[:50], np.array([True, True, False])), Answer(values[:0], np.ones(3, bool))]
    models = [continue_training(bundle, more, values[~wrong], Replay(values, allowed)) for _ in range(2)]
    old, new = (BoostedTrees.from_arrays(b.arrays) for b in (bundle, models[0]))
    for feature in range(4):
        assert set(new.threshold[new.feature == feature]) <= set(old.threshold[old.feature == feature])
    for name, array in models[0].arrays.items():
        np.testing.assert_array_equal(array, models[1].arrays[name])


def test_what_cannot_be_learned_is_refused(bundle, rows):
    values, allowed = rows
    with pytest.raises(DataError, match="no answer to learn from"):
        continue_training(bundle, [], values, Replay(values, allowed))
    with pytest.raises(DataError, match="must allow one or more of the 3 classes"):
        continue_training(bundle, [Answer(values[:9], np.zeros(3, bool))], values, Replay(values, allowed))


def test_the_shipped_replay_is_for_the_classes_of_the_shipped_model():
    general = load_shipped("general")
    replay = read_replay(general)
    assert replay.values.shape == (6000, len(general.metadata["feature_names"]))
    probabilities = softmax(BoostedTrees.from_arrays(general.arrays).scores(replay.values))
    assert (probabilities * replay.allowed).sum(axis=1).mean() > 0.7  # the model knows what it was trained on
    other = ModelBundle("boosted_trees", general.arrays, {**general.metadata, "classes": ["a"]})
    with pytest.raises(ParameterError, match="has other classes than the shipped models"):
        read_replay(other)


def test_segments_are_connected_voxels_of_one_class_within_a_cell():
    line = np.arange(0, 8, 0.2)[:, None] * [1.0, 0, 0]
    apart = line[:10] + [0, 3.0, 0]
    xyz = np.concatenate([line, line + [0, 0.2, 0], apart])
    probabilities = np.repeat([[0.9, 0.1], [0.2, 0.8], [0.9, 0.1]], [40, 40, 10], axis=0)
    found = find_segments(xyz, np.zeros((90, 2), np.float32), probabilities)
    expected = [*[0] * 20, *[1] * 20, *[2] * 20, *[3] * 20, *[4] * 10]
    pairs = set(zip(expected, found.owner.tolist(), strict=True))
    assert len(pairs) == len(found.size) == 5 and sorted(found.size) == [10, 20, 20, 20, 20]


def test_questions_begin_with_uncertain_segments_and_do_not_repeat_alike_ones():
    xyz = np.repeat(np.arange(4)[:, None] * [50.0, 0, 0], 30, axis=0) + np.tile(
        np.arange(30)[:, None] * [0, 0.1, 0], (4, 1)
    )
    probabilities = np.repeat([[0.55, 0.45], [0.55, 0.45], [0.6, 0.4], [0.99, 0.01]], 30, axis=0)
    values = np.repeat(np.array([[0.0], [0.0], [9.0], [4.0]], np.float32), 30, axis=0)
    segments = find_segments(xyz, values, probabilities)
    order = order_of_questions(segments, 3)
    place = [int(segments.owner[30 * k]) for k in range(4)]
    assert order.tolist()[:2] in ([place[0], place[2]], [place[1], place[2]])
    rest = order_of_questions(segments, 9, asked=order)
    assert set(rest.tolist()) == set(place) - set(order.tolist())
