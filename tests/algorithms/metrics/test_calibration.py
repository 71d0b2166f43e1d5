"""Calibration against scikit-learn, loops and closed forms."""

import numpy as np
import pytest
from sklearn.metrics import brier_score_loss, roc_auc_score

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.metrics.calibration import auroc, brier_score, reliability_table


@pytest.fixture(scope="module")
def sample():
    rng = np.random.default_rng(3)
    confidence = np.round(rng.random(4000), 2)  # many ties
    return confidence, rng.random(4000) < confidence**2


def slow_calibration_error(confidence, right, n_bins):
    total = 0.0
    for k in range(n_bins):
        low, high = k / n_bins, (k + 1) / n_bins
        rows = [i for i, c in enumerate(confidence) if low <= c < high or (k == n_bins - 1 and c == 1)]
        if rows:
            total += abs(np.mean(right[rows]) - np.mean(confidence[rows])) * len(rows) / len(right)
    return total


@pytest.mark.parametrize("n_bins", [1, 4, 15])
def test_calibration_error_is_that_of_a_loop_over_bins(sample, n_bins):
    confidence, right = sample
    confidence = np.clip(confidence + 1e-4, 0, 1)  # off the ends of bins, where rounding decides
    table = reliability_table(confidence, right, n_bins=n_bins)
    assert table.calibration_error == pytest.approx(slow_calibration_error(confidence, right, n_bins), abs=1e-12)


def test_calibration_error_of_a_constant_confidence_is_the_difference_to_the_accuracy():
    right = np.arange(10) < 7
    table = reliability_table(np.full(10, 0.9), right)
    assert table.calibration_error == pytest.approx(0.2)
    assert np.nanmax(table.accuracy) == 0.7
    assert np.nanmax(table.confidence) == pytest.approx(0.9)
    assert np.isnan(table.accuracy).sum() == 14


def test_tables_of_parts_add_up_to_the_table_of_all_points(sample):
    confidence, right = sample
    parts = reliability_table(confidence[:1500], right[:1500]) + reliability_table(confidence[1500:], right[1500:])
    whole = reliability_table(confidence, right)
    assert (parts.counts == whole.counts).all()
    assert (parts.hits == whole.hits).all()
    assert parts.calibration_error == pytest.approx(whole.calibration_error, abs=1e-12)


def test_a_confidence_of_one_is_in_the_last_bin():
    assert reliability_table([1.0, 0.0], [True, False]).counts[[0, -1]].tolist() == [1, 1]


def test_auroc_and_brier_score_are_those_of_scikit_learn(sample):
    confidence, right = sample
    assert auroc(confidence, right) == pytest.approx(roc_auc_score(right, confidence), abs=1e-12)
    assert brier_score(confidence, right) == pytest.approx(brier_score_loss(right, confidence), abs=1e-12)


def test_auroc_of_equal_confidences_is_a_half_and_of_separate_ones_is_one():
    assert auroc([0.4, 0.4, 0.4], [True, False, True]) == 0.5
    assert auroc([0.1, 0.2, 0.8], [False, False, True]) == 1.0


def test_undefined_scores_are_nan():
    assert np.isnan(auroc([0.5, 0.6], [True, True]))
    assert np.isnan(brier_score([], []))
    assert np.isnan(reliability_table([], []).calibration_error)


@pytest.mark.parametrize("function", [auroc, brier_score, reliability_table])
def test_wrong_input_is_named(function):
    with pytest.raises(DataError, match=r"got \(2,\) and \(1,\)"):
        function([0.1, 0.2], [True])
    with pytest.raises(DataError, match=r"in \[0, 1\], got 0.5 to 1.5"):
        function([0.5, 1.5], [True, False])


def test_number_of_bins_is_checked():
    with pytest.raises(ParameterError, match="n_bins"):
        reliability_table([0.5], [True], n_bins=0)
