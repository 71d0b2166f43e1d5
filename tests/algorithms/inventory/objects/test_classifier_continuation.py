"""A classifier that learns from answers rates alike candidates as the answers say, and the others about as before."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.objects import object_classifier
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import (
    LabelledCandidates,
    ObjectClassifier,
    continue_classifier,
)
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import MAX_THRESHOLDS
from mlsroad_pipeline.model_store.object_classifiers import read_candidate_replay, shipped_classifier


@pytest.fixture(scope="module")
def replay():
    return read_candidate_replay()


def uncertain(replay, kind="vehicle"):
    """Return candidates of a kind with medium scores, which answers can move."""
    values = replay[kind].values
    score = shipped_classifier().probabilities(kind, values)[:, 0]
    return values[np.argsort(np.abs(score - 0.5), kind="stable")[:20]]


@pytest.mark.parametrize("true", [False, True])
def test_scores_follow_the_answers(replay, true):
    values = uncertain(replay)
    answers = {"vehicle": LabelledCandidates(values, np.full(len(values), true))}
    classifier = continue_classifier(shipped_classifier(), answers, replay)
    before, after = (j.probabilities("vehicle", values)[:, 0] for j in (shipped_classifier(), classifier))
    assert (after.mean() > before.mean() + 0.1) if true else (after.mean() < before.mean() - 0.1)
    rest = replay["vehicle"].values[:500]
    before, after = (j.probabilities("vehicle", rest)[:, 0] for j in (shipped_classifier(), classifier))
    assert np.median(np.abs(after - before)) < 0.05
    for kind in ("pole", "sign", "tree", "stem"):
        assert classifier.trees[kind] is shipped_classifier().trees[kind]


def test_learning_again_brings_no_new_thresholds(replay, monkeypatch):
    monkeypatch.setattr(object_classifier, "ADDED_TREES", 10)
    values = uncertain(replay, "pole")
    answers = {"pole": LabelledCandidates(values, np.arange(len(values)) % 2 == 0)}
    classifier = shipped_classifier()
    for _ in range(3):
        classifier = continue_classifier(classifier, answers, replay)
    again = ObjectClassifier.from_arrays(classifier.to_arrays())
    np.testing.assert_array_equal(again.scores("pole", values), classifier.scores("pole", values))
    counts = [
        len(np.unique(classifier.trees["pole"].threshold[classifier.trees["pole"].feature == f]))
        for f in range(values.shape[1])
    ]
    assert (
        max(counts) <= MAX_THRESHOLDS and len(classifier.trees["pole"]) == len(shipped_classifier().trees["pole"]) + 30
    )


def test_unknown_kinds_and_features_are_refused(replay):
    values = uncertain(replay)
    with pytest.raises(DataError, match="has no trees of the kind 'bench'"):
        continue_classifier(shipped_classifier(), {"bench": LabelledCandidates(values, np.ones(20, bool))}, replay)
    with pytest.raises(DataError, match=r"the answers have 5 features, the object classifier \d+"):
        continue_classifier(
            shipped_classifier(), {"pole": LabelledCandidates(values[:, :5], np.ones(20, bool))}, replay
        )
