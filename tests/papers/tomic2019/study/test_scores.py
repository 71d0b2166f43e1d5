"""Experiment of tomic2019 on planted labellers, division of surveys, consistency of the printed tables."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.metrics.confusion import scores
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import best_labels, spread_confidence
from mlsroad_pipeline.papers.tomic2019.study.plan import StudyParameters, StudyPlan, StudyScale
from mlsroad_pipeline.papers.tomic2019.study.runs import Division
from mlsroad_pipeline.papers.tomic2019.study.scores import (
    ALL_POINTS,
    FEATURES,
    IMAGES,
    POOL,
    RULE,
    VISIBLE,
    FusionScores,
    TestSet,
    fuse_test_sets,
)
from mlsroad_pipeline.papers.tomic2019.study.study import paper_scores


def drawn(rng, truth, right):
    """Return labels that are correct with a probability per class, otherwise the next class."""
    return np.where(rng.random(len(truth)) < np.asarray(right)[truth], truth, (truth + 1) % 3)


def planted(rng, n=12_000):
    """Return points for which features are best for class a, camera x for b, camera y for c; a third is in no image."""
    truth = rng.choice(3, n, p=[0.5, 0.3, 0.2])
    labels = drawn(rng, truth, [0.95, 0.6, 0.5])
    cameras = np.stack([drawn(rng, truth, right) for right in ([0.8, 0.95, 0.6], [0.7, 0.6, 0.95])])
    seen = np.stack([rng.random(n) < 0.8, rng.random(n) < 0.8]) & (rng.random(n) < 0.7)
    probabilities = np.full((2, n, 3), 0.1, dtype=np.float32)
    np.put_along_axis(probabilities, cameras[:, :, None], np.float32(0.8), axis=2)
    probabilities[~seen] = np.nan
    return TestSet(truth, spread_confidence(labels, np.full(n, 0.8), 3), probabilities)


def accuracy_of(fused, method, split):
    return scores(fused.scores.confusions[f"{method}.{split}"]).overall_accuracy


def test_what_each_knows_best_is_believed_and_the_fusion_is_better_than_either(rng):
    fused = fuse_test_sets(planted(rng), planted(rng))
    assert fused.scores.camera_f1[:, 1:].argmax(axis=0).tolist() == [0, 1]
    accuracy = {method: accuracy_of(fused, method, ALL_POINTS) for method in (FEATURES, IMAGES, RULE, POOL)}
    assert accuracy[POOL] > accuracy[RULE] > accuracy[FEATURES] + 0.03 > accuracy[IMAGES]
    # Unseen points are wrong for the images over all points, and not counted over visible ones.
    assert accuracy_of(fused, IMAGES, VISIBLE) > accuracy[IMAGES] + 0.2
    assert accuracy_of(fused, RULE, VISIBLE) > accuracy_of(fused, FEATURES, VISIBLE)


def test_points_in_no_image_keep_the_label_of_the_features(rng):
    second = planted(rng)
    fused = fuse_test_sets(planted(rng), second)
    unseen = np.isnan(second.cameras[:, :, 0]).all(axis=0)
    assert unseen.any() and np.array_equal(fused.labels[RULE][unseen], best_labels(second.features)[unseen])
    assert fused.scores.redundancy.sum() == len(second.reference) and fused.scores.redundancy[1].sum() == unseen.sum()


def test_the_reference_of_test_set_2_changes_no_label(rng):
    first, second = planted(rng), planted(rng)
    blind = TestSet(np.roll(second.reference, 1), second.features, second.cameras)
    one, other = (fuse_test_sets(first, part) for part in (second, blind))
    assert all(np.array_equal(one.labels[name], other.labels[name]) for name in one.labels)


def test_scores_survive_their_stored_form(rng):
    found = fuse_test_sets(planted(rng, 500), planted(rng, 500)).scores
    again = FusionScores.from_arrays({**found.to_arrays(), "cameras": np.array(["x", "y"])})
    assert list(again.confusions) == list(found.confusions) and again.penalty == found.penalty
    for name, array in found.to_arrays().items():
        np.testing.assert_array_equal(again.to_arrays()[name], array)


def test_confidences_become_probabilities():
    out = spread_confidence(np.array([1, -1]), np.array([0.8, 0.0]), 3)
    np.testing.assert_allclose(out[0], [0.1, 0.8, 0.1], atol=1e-6)
    assert np.isnan(out[1]).all() and best_labels(out).tolist() == [1, -1]


def test_sets_that_do_not_fit_are_named(rng):
    first = planted(rng, 100)
    with pytest.raises(DataError, match="100 reference labels but 99 of features"):
        TestSet(first.reference, first.features[1:], first.cameras)
    with pytest.raises(DataError, match="100 reference labels but 98 of cameras"):
        TestSet(first.reference, first.features, first.cameras[:, 2:])
    with pytest.raises(DataError, match="expected labels of 2 labellers"):
        fuse_test_sets(first, TestSet(first.reference, first.features, first.cameras[:1]))


def test_parts_of_a_survey_share_no_point_and_leave_the_gaps_out():
    station = np.linspace(0, 100, 1001)
    division = Division(100.0, 4.0)
    train, test, first, second = (station[division.rows(station, part)] for part in ("train", "test", "test1", "test2"))
    assert (train.max(), test.min(), test.max()) == pytest.approx((48, 52, 100))
    assert (first.min(), first.max(), second.min(), second.max()) == pytest.approx((52, 73, 77, 100))
    with pytest.raises(DataError, match="no point of the survey lies in the part 'test2'"):
        division.rows(station[:600], "test2")
    with pytest.raises(ParameterError, match="below a quarter of the survey's 100 m, got 25"):
        Division(100.0, 25.0)


def test_streets_in_both_lists_are_refused():
    with pytest.raises(ParameterError, match=r"must be non-empty and distinct, got \[1, 2\] and \[2\]"):
        StudyScale({}, [1, 2], [{}], [2])
    with pytest.raises(ParameterError, match="must not have a seed; use seeds and photograph_seeds"):
        StudyScale({}, [1], [{}, {"seed": 1}], [2])
    with pytest.raises(ParameterError, match="must have at least one kind of street"):
        StudyScale({}, [1], [], [2])
    with pytest.raises(ParameterError, match=r"train_on is 'other', but seeds has one survey"):
        StudyScale({}, [1], [{}], [2])
    with pytest.raises(ParameterError, match=r"train_on .*got 'both'"):
        StudyScale({}, [1], [{}], [2], train_on="both")


@pytest.mark.parametrize(("train_on", "expected"), [("other", ["seed_5", "seed_6", "seed_4"]), ("same", None)])
def test_features_learn_from_another_survey_or_their_own(train_on, expected):
    scale = {"survey": {}, "seeds": [4, 5, 6], "photographs": [{}], "photograph_seeds": [1], "train_on": train_on}
    study = StudyParameters("s", {"s": {**scale, "gap": 1.0, "methods": {}}}, {}, {})
    plan = StudyPlan(study, None, None, None, {}, None, None)
    assert [plan.training_street(street) for street in plan.streets] == (expected or plan.streets)


@pytest.mark.parametrize(
    ("method", "accuracy", "mean_f1"),
    [("features", 0.721, 2.8 / 9), ("images", 0.649, 0.2995), ("fusion", 0.868, 0.3483)],
)
def test_the_papers_figures_agree_with_each_other(method, accuracy, mean_f1):
    """Precision, recall, IoU and F1 of a class determine each other up to rounding of the third digit."""
    table = paper_scores(method).set_index("class")
    overall = table.loc["all"]
    assert overall["overall_accuracy"] == accuracy and overall["mean_f1"] == pytest.approx(mean_f1, abs=6e-4)
    wide = table[["precision", "recall", "iou", "f1"]].dropna()
    np.testing.assert_allclose(wide["f1"], 2 * wide["iou"] / (1 + wide["iou"]), atol=0.0025)
    large = wide[wide["recall"] > 0.05]
    expected = 2 * large["precision"] * large["recall"] / (large["precision"] + large["recall"])
    np.testing.assert_allclose(large["f1"], expected, atol=0.0025)
