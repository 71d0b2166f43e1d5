"""A judge that learns from answers rates alike candidates as the answers say, and the others about as before."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.inventory.objects.classifier_continuation import (
    JudgeContinuation,
    JudgedCandidates,
    continue_judge,
)
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import ObjectJudge
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import MAX_THRESHOLDS
from mlsroad_pipeline.model_store.object_judges import read_judge_replay, shipped_judge


@pytest.fixture(scope="module")
def replay():
    return read_judge_replay()


def uncertain(replay, kind="vehicle"):
    """Return candidates of a kind with medium scores, which answers can move."""
    values = replay[kind].values
    score = shipped_judge().probabilities(kind, values)[:, 0]
    return values[np.argsort(np.abs(score - 0.5), kind="stable")[:20]]


@pytest.mark.parametrize("true", [False, True])
def test_scores_follow_the_answers(replay, true):
    values = uncertain(replay)
    answers = {"vehicle": JudgedCandidates(values, np.full(len(values), true))}
    judge = continue_judge(shipped_judge(), answers, replay)
    before, after = (j.probabilities("vehicle", values)[:, 0] for j in (shipped_judge(), judge))
    assert (after.mean() > before.mean() + 0.1) if true else (after.mean() < before.mean() - 0.1)
    rest = replay["vehicle"].values[:500]
    before, after = (j.probabilities("vehicle", rest)[:, 0] for j in (shipped_judge(), judge))
    assert np.median(np.abs(after - before)) < 0.05
    for kind in ("pole", "sign", "tree", "stem"):
        assert judge.trees[kind] is shipped_judge().trees[kind]


def test_learning_again_brings_no_new_thresholds(replay):
    values = uncertain(replay, "pole")
    answers = {"pole": JudgedCandidates(values, np.arange(len(values)) % 2 == 0)}
    judge = shipped_judge()
    for _ in range(3):
        judge = continue_judge(judge, answers, replay, parameters=JudgeContinuation(rounds=10))
    again = ObjectJudge.from_arrays(judge.to_arrays())
    np.testing.assert_array_equal(again.scores("pole", values), judge.scores("pole", values))
    counts = [
        len(np.unique(judge.trees["pole"].threshold[judge.trees["pole"].feature == f])) for f in range(values.shape[1])
    ]
    assert max(counts) <= MAX_THRESHOLDS and len(judge.trees["pole"]) == len(shipped_judge().trees["pole"]) + 30


def test_what_the_judge_does_not_know_is_refused(replay):
    values = uncertain(replay)
    with pytest.raises(DataError, match="has no trees of the kind 'bench'"):
        continue_judge(shipped_judge(), {"bench": JudgedCandidates(values, np.ones(20, bool))}, replay)
    with pytest.raises(DataError, match=r"the answers have 5 features, the judge \d+"):
        continue_judge(shipped_judge(), {"pole": JudgedCandidates(values[:, :5], np.ones(20, bool))}, replay)
    with pytest.raises(ParameterError, match="learn.objects.rounds"):
        JudgeContinuation(rounds=0)
