"""Confusion matrix and its scores against scikit-learn."""

import numpy as np
import pytest
from references import evaluation as references
from sklearn import metrics as sk

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores


@pytest.fixture
def labels(rng):
    truth = rng.integers(-1, 5, 4000)
    predicted = np.where(rng.random(4000) < 0.6, truth, rng.integers(-1, 5, 4000))
    return truth, predicted


@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int32, np.int64])
def test_matrix_equals_counting_one_by_one(labels, dtype):
    truth, predicted = (values.astype(dtype) for values in labels)
    assert np.array_equal(confusion_matrix(truth, predicted, 5), references.confusion_matrix(truth, predicted, 5))


def test_matrix_is_additive_over_scenes_and_leaves_its_input_alone(labels):
    truth, predicted = labels
    before = truth.copy(), predicted.copy()
    parts = sum(confusion_matrix(truth[s], predicted[s], 5) for s in (slice(0, 1000), slice(1000, None)))
    assert np.array_equal(parts, confusion_matrix(truth, predicted, 5))
    assert np.array_equal(truth, before[0])
    assert np.array_equal(predicted, before[1])


def test_matrix_of_more_points_than_one_chunk(rng):
    truth = rng.integers(0, 3, (1 << 20) + 7).astype(np.int16)
    matrix = confusion_matrix(truth, truth, 3)
    assert np.array_equal(matrix[:, :3], np.diag(np.bincount(truth)))
    truth[-1] = 3
    with pytest.raises(DataError, match=f"row {len(truth) - 1} has truth 3"):
        confusion_matrix(truth, truth, 3)


def test_figures_equal_scikit_learn(labels):
    truth, predicted = labels
    result = scores(confusion_matrix(truth, predicted, 5))
    known = truth >= 0
    t, p = truth[known], predicted[known]
    classes = range(5)
    precision, recall, f1, support = sk.precision_recall_fscore_support(t, p, labels=list(classes))
    np.testing.assert_allclose(result.precision, precision)
    np.testing.assert_allclose(result.recall, recall)
    np.testing.assert_allclose(result.f1, f1)
    np.testing.assert_allclose(result.iou, sk.jaccard_score(t, p, labels=list(classes), average=None))
    np.testing.assert_array_equal(result.support, support)
    assert result.overall_accuracy == pytest.approx(sk.accuracy_score(t, p))
    assert result.kappa == pytest.approx(sk.cohen_kappa_score(t, p))
    assert result.mean_f1 == pytest.approx(f1.mean())


def test_undefined_figures_are_nan_and_means_run_over_classes_with_support():
    # class 1 has no points but is predicted; class 2 has points but is never predicted; class 3 has neither
    result = scores(np.array([[6, 2, 0, 0, 0], [0, 0, 0, 0, 0], [1, 0, 0, 0, 1], [0, 0, 0, 0, 0]]))
    np.testing.assert_array_equal(np.isnan(result.precision), [False, False, True, True])
    np.testing.assert_array_equal(np.isnan(result.recall), [False, True, False, True])
    np.testing.assert_array_equal(result.f1, [12 / 15, 0, 0, np.nan])
    np.testing.assert_array_equal(result.iou, [6 / 9, 0, 0, np.nan])
    assert result.mean_f1 == pytest.approx((12 / 15 + 0) / 2)
    assert result.mean_iou == pytest.approx((6 / 9 + 0) / 2)
    assert result.overall_accuracy == pytest.approx(0.6)


def test_no_points_give_nan_everywhere():
    result = scores(confusion_matrix(np.zeros(0, np.int16), np.zeros(0, np.int16), 2))
    assert np.isnan([result.overall_accuracy, result.kappa, result.mean_f1, result.mean_iou]).all()
    assert np.isnan(result.f1).all()


def test_kappa_is_undefined_where_chance_alone_agrees():
    assert np.isnan(scores(np.array([[5, 0], [0, 0]])).kappa)


def test_unlabelled_points_are_wrong_but_no_false_positives():
    result = scores(confusion_matrix([0, 0, 1], [0, -1, 1], 2))
    np.testing.assert_array_equal(result.precision, [1, 1])
    np.testing.assert_array_equal(result.recall, [0.5, 1])


@pytest.mark.parametrize(
    ("truth", "predicted", "n_classes", "error", "message"),
    [
        ([0, 1], [0], 2, DataError, "2 true labels but 1 predicted"),
        ([0, 5], [0, 0], 2, DataError, "row 1 has truth 5"),
        ([0, 0], [0, -2], 2, DataError, "predicted -2"),
        ([0.0, 1.5], [0, 1], 2, DataError, "truth labels must be integers"),
        ([[0], [1]], [0, 1], 2, DataError, r"shape \(n,\)"),
        ([0], [0], 0, ParameterError, "n_classes must be at least 1"),
    ],
)
def test_bad_labels_are_named(truth, predicted, n_classes, error, message):
    with pytest.raises(error, match=message):
        confusion_matrix(truth, predicted, n_classes)


@pytest.mark.parametrize("shape", [(2, 4), (3, 2), (0, 0), (4,)])
def test_a_matrix_of_another_shape_is_refused(shape):
    with pytest.raises(DataError, match="a confusion matrix has shape"):
        scores(np.zeros(shape, dtype=int))


def test_negative_counts_are_refused():
    with pytest.raises(DataError, match="holds counts, got -1"):
        scores(np.array([[1, -1], [0, 1]]))
