"""Detections against reference objects, by planted cases and scikit-learn's curve."""

import numpy as np
import pytest
from sklearn.metrics import precision_recall_curve as sklearn_curve

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.detection import (
    DetectionCounts,
    count_detections,
    detection_scores,
    match_detections,
    precision_recall_curve,
)
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps

CAR, POLE = 1, 2


def scene():
    """Four objects (two cars, a pole, a car that is split in halves) and a false alarm."""
    instances = np.repeat([1, 2, 3, 4, 0], [10, 10, 10, 10, 5])
    segments = np.repeat([0, 1, 2, 3, 4, 5], [10, 10, 10, 5, 5, 5])
    kinds = np.array([CAR, CAR, POLE, CAR])
    return find_overlaps(instances, segments), kinds


def test_right_wrong_and_missing():
    overlaps, kinds = scene()
    scores = np.array([0.9, 0.4, 0.8, 0.6, 0.7, 0.3])
    order, right = match_detections(overlaps, scores, kinds == CAR)
    np.testing.assert_array_equal(order, [0, 2, 4, 3, 1, 5])
    # Of the two halves, each with an IoU of 0.5, the better scored one is right and the other one too late.
    np.testing.assert_array_equal(right, [True, False, True, False, True, False])
    counts = count_detections(right, 3)
    assert (counts.tp, counts.fp, counts.fn) == (3, 3, 0)
    assert (counts.precision, counts.recall, counts.quality, counts.f_score) == pytest.approx((0.5, 1, 0.5, 2 / 3))


def test_what_is_not_detected_does_not_match():
    overlaps, kinds = scene()
    order, right = match_detections(overlaps, [np.nan, 0.5, np.nan, np.nan, np.nan, np.nan], kinds == CAR)
    assert order.tolist() == [1] and right.tolist() == [True]
    assert count_detections(right, 3).fn == 2


def test_a_better_overlap_is_preferred_and_an_object_is_matched_once():
    instances, segments = np.repeat([1, 2], [10, 10]), np.repeat([0, 1, 0], [10, 2, 8])
    overlaps = find_overlaps(instances, segments)
    _, right = match_detections(overlaps, [0.9, 0.8], [True, True], iou_threshold=0.1)
    assert right.tolist() == [True, True]


def test_curve_equals_scikit_learn(rng):
    scores, right = np.round(rng.random(200), 2), rng.random(200) < 0.4
    threshold, precision, recall = precision_recall_curve(scores, right, int(right.sum()))
    theirs = sklearn_curve(right, scores)
    np.testing.assert_allclose(precision, theirs[0][:-1][::-1])
    np.testing.assert_allclose(recall, theirs[1][:-1][::-1])
    np.testing.assert_allclose(threshold, theirs[2][::-1])


def test_table_has_means_over_classes_with_objects_and_sums_of_counts():
    counts = [DetectionCounts(8, 2, 0), DetectionCounts(1, 1, 2), DetectionCounts(0, 4, 0)]
    table = detection_scores(counts, method="visual_words", split="test", classes=["pole", "sign", "car"])
    value = table.set_index(["class", "metric"])["value"]
    assert value["all", "precision"] == pytest.approx((0.8 + 0.5) / 2)
    assert value["all", "recall"] == pytest.approx((1 + 1 / 3) / 2)
    assert value["all", "fp"] == 7 and np.isnan(value["car", "recall"])
    assert table.set_index(["class", "metric"])["support"]["sign", "tp"] == 3


def test_figures_without_anything_are_undefined():
    nothing = DetectionCounts(0, 0, 0)
    assert np.isnan([nothing.precision, nothing.recall, nothing.quality, nothing.f_score]).all()


def test_bad_input():
    overlaps, kinds = scene()
    with pytest.raises(DataError, match=r"6 segments have \(2,\) scores, 4 instances \(4,\) flags"):
        match_detections(overlaps, [1.0, 2.0], kinds == CAR)
    with pytest.raises(DataError, match="2 detections are right, but there are 1 objects"):
        count_detections([True, True], 1)
    with pytest.raises(DataError, match="0 detections are right, but there are 0 objects"):
        precision_recall_curve([0.5], [False], 0)
    with pytest.raises(DataError, match=r"\(2,\) scores for \(1,\) detections"):
        precision_recall_curve([0.5, 0.2], [False], 1)
    with pytest.raises(DataError, match="none may be called 'all'"):
        detection_scores([DetectionCounts(1, 0, 0)], method="m", split="test", classes=["all"])
