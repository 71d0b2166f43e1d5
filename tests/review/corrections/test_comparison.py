"""Comparison of a model with the one before: folds, verdicts, and the voxels without an answer."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.models.boosted_trees import answer_boosting
from mlsroad_pipeline.algorithms.models.boosted_trees.answer_boosting import Answer, ContinuationSettings, Scored
from mlsroad_pipeline.model_store.object_classifiers import read_replay
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.review.corrections.comparison import (
    BETTER,
    FOLDS,
    SAME,
    WORSE,
    Comparison,
    _rest,
    compare_learning,
    turns,
)
from mlsroad_pipeline.review.corrections.learners import _log_probabilities
from mlsroad_pipeline.review.corrections.learning import Learned, train_on

NO_OBJECTS = pd.DataFrame({"kind": [], "before": [], "after": []})


def compared(before, after, *, lost=0, voxels=1000, changed=0.1):
    answers = pd.DataFrame({"class": "tree", "before": before, "after": after}, dtype=object)
    answers = answers.astype({"before": float, "after": float})
    rest = pd.DataFrame(
        {"class": ["road", "wall"], "voxels": [voxels, 50], "changed": [lost, 50], "to": ["car", "tree"]}
    )
    return Comparison(answers, NO_OBJECTS, rest, changed)


def test_answers_of_a_class_are_dealt_over_all_folds():
    groups = ["tree"] * 9 + ["pole"] * 4 + ["sign"]
    fold = turns(groups)
    assert set(fold.tolist()) == set(range(FOLDS))
    for name, n in (("tree", 9), ("pole", 4)):
        counts = np.bincount(fold[np.array(groups) == name], minlength=FOLDS)
        assert counts.sum() == n and counts.max() - counts.min() <= 1


@pytest.mark.parametrize(
    ("before", "after", "lost", "verdict"),
    [
        ([0.2] * 10, [0.9] * 10, 10, BETTER),
        ([0.9] * 10, [0.2] * 10, 10, WORSE),
        ([0.5] * 10, [0.5] * 10, 10, SAME),
        ([0.5] * 10, [0.5] * 9 + [0.6], 0, SAME),  # a single answer
        ([0.5] * 10, [0.6] * 10, 300, WORSE),  # a class loses more than the answers gain
        ([0.2] * 10, [0.9] * 10, 300, BETTER),
        ([], [], 10, SAME),
        ([], [], 300, WORSE),
    ],
)
def test_the_verdict_weighs_held_out_answers_and_the_rest(before, after, lost, verdict):
    found, reason = compared(before, after, lost=lost).verdict()
    assert found == verdict
    assert ("fewer than 8 answers" in reason) == (not before)
    assert (f"{lost / 1000:.0%} of the sure road without an answer become car" in reason) == (lost > 50)
    assert "wall" not in reason  # too few voxels
    assert reason.endswith("10.0% of the voxels without an answer change class")
    assert ("of the other voxels become right if they gain like these answers" in reason) == bool(before)


@pytest.mark.parametrize(
    ("before", "after", "changed", "verdict"),
    [
        ([0.2] * 10, [0.9] * 10, 0.004, SAME),  # hardly a voxel changes
        ([0.2] * 10, [0.9] * 10, 0.02, BETTER),
        ([0.5] * 10, [1.0] * 6 + [0.2] * 4, 0.2, SAME),  # the interval includes zero
        ([0.5] * 30, [1.0] * 24 + [0.2] * 6, 0.2, BETTER),
    ],
)
def test_a_better_model_makes_a_share_of_the_survey_right_beyond_chance(before, after, changed, verdict):
    found = compared(before, after, changed=changed)
    assert found.verdict()[0] == verdict
    low, high = found.expected()
    gain = np.subtract(after, before)
    reach = 1.645 * gain.std() / np.sqrt(len(gain))  # of normally distributed means
    assert np.divide([low, high], changed) == pytest.approx([gain.mean() - reach, gain.mean() + reach], abs=0.08)


def test_changes_of_sure_voxels_are_counted_by_class():
    names = np.array(["road", "car", "tree"])
    before, after = np.array([0, 0, 0, 1, 2, 2]), np.array([0, 1, 1, 1, 0, 2])
    table = _rest(names, before, after, np.array([True, True, True, True, False, True]))
    assert table.to_dict("list") == {
        "class": ["road", "car", "tree"], "voxels": [3, 1, 1], "changed": [2, 0, 0], "to": ["car", "", ""],
    }  # fmt: skip


def test_right_and_wrong_answers_about_known_voxels(monkeypatch):
    """Voxels of the streets that the model was trained on: right answers do no harm, wrong ones are found out."""
    bundle = load_shipped("general")
    replay, names = read_replay(bundle), list(bundle.classes)
    rng = np.random.default_rng(3)
    monkeypatch.setattr(answer_boosting, "SETTINGS", ContinuationSettings(rounds=5, bags=1))
    values = replay.values.astype(np.float32)
    known = replay.allowed.argmax(axis=1)
    before = _log_probabilities(bundle, values)

    def answers(wrong):
        found = []
        for k, label in enumerate(np.repeat([names.index(n) for n in ("paved ground", "tree", "building")], 4)):
            rows = rng.permutation(np.flatnonzero(known == label))[:60]
            said = rng.integers(len(names)) if wrong else label
            found.append(Answer(values[rows], np.arange(len(names)) == said, before[rows]))
            assert len(rows) > 20, k
        return found

    for wrong in (False, True):
        data = Learned(answers(wrong), [Scored(values[:2000], before[:2000])], [])
        model, n = train_on(bundle, data, parent={"name": "general", "version": ""}, surveys=["s"])
        found = compare_learning(bundle, model, data)
        assert n == len(found.answers) == 12
        if wrong:
            assert found.verdict()[0] != BETTER
        else:
            assert found.answers["before"].mean() > 0.8
            assert found.answers["after"].mean() > found.answers["before"].mean() - 0.05
        assert found.rest["voxels"].sum() > 0 and 0 <= found.changed < 1
