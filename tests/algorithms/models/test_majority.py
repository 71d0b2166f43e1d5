"""Majority labels against hand-counted cases."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.majority import majority_labels


def test_the_majority_is_counted_without_ignored_points():
    labels, purity = majority_labels([0, 1, 1, -1, -1, 2, 0, 2], [0, 0, 0, 0, 1, 2, 2, 4], 3)
    assert labels.dtype == np.int16
    assert labels.tolist() == [1, -1, 0, -1, 2]  # of equal counts the lowest class; 1 and 3 have no labelled point
    assert np.allclose(purity, [2 / 3, np.nan, 1 / 2, np.nan, 1], equal_nan=True)
    labels, purity = majority_labels([], [], 3)
    assert (len(labels), len(purity)) == (0, 0)


def test_majority_labels_name_bad_input():
    with pytest.raises(DataError, match=r"point_labels must be in -1\.\.1, got 0\.\.2"):
        majority_labels([0, 2], [0, 0], 2)
    with pytest.raises(DataError, match=r"point_labels must have shape \(3,\), got \(2,\)"):
        majority_labels([0, 1], [0, 0, 0], 2)
    with pytest.raises(DataError, match="group_of_point must not be negative, got -2"):
        majority_labels([0, 1], [0, -2], 2)
